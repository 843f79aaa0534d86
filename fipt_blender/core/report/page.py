"""Engine command `report RUN`: one HTML page with its images beside it, readable offline.

Any part of a run may be missing (a run without renders, or one that was stopped); the page shows what exists.
"""

from __future__ import annotations

import argparse
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.averaging import means, narrowed
from ..capture.images import open_picture, read_radiance
from ..capture.views import View, load_capture
from ..run.contents import JobNote
from ..run.declared import declared
from ..run.documents import read_document
from ..run.kinds import T
from ..run.messages import Reporter
from ..run.result_contents import (
    EmitterFixture,
    Emitters,
    QualityNote,
    Render,
    Renders,
)
from ..run.runfolder import PRODUCT_VERSION, RunFolder, explained_write_errors
from ..run.settings import Settings
from .comparison import ERROR_FULL, choose_exposure, error_picture, psnr, to_display
from .fixture_names import run_fixture_names
from .html import write_page
from .pictures import KINDS, write_png

MAPS = ("base_color", "roughness", "metallic", "emission")
PICTURE_WIDTH = 1280  # of photographs and renders on the page, at most; larger ones are averaged
_TITLES = {
    "rerender": "Re-rendered view",
    "relight": "Estimated lights off, a new area light on",
    "insert": "With an inserted object",
    "composite": "An inserted object in the photograph",
}


@dataclass(frozen=True)
class Shot:
    """One Cycles render; `photo` and `error` are addresses of pictures, `psnr` is in dB."""

    title: str
    view: str
    image: str
    photo: str | None = None
    error: str | None = None
    psnr: float | None = None
    held_back: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="the run folder")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Write report/index.html of a run folder.

    Raises:
        FiptError: see :func:`write_report`.
    """
    reporter.plan([1.0])
    reporter.stage("report", "Writing the report")
    page = write_report(RunFolder(arguments.run), reporter.progress)
    reporter.done([str(page)])


def write_report(run: RunFolder, progress: Callable[[float], None] = lambda fraction: None) -> Path:
    """Write the page and its images; returns the page's path.

    Raises:
        FiptError: ``run-missing``, ``run-damaged``, ``run-version``, ``path-outside``, ``disk-full`` or
            ``run-unwritable``.
    """
    settings = run.read_estimated()
    pictures = _Pictures(run)
    capture = pictures.capture
    listed = _optional(run.renders_json, Renders)
    renders = listed.renders if listed else ()
    pictures.expose({render.view for render in renders})
    shots = []
    for index, render in enumerate(renders):
        shots.append(_shot(run, render, pictures))
        progress(0.6 * (index + 1) / len(renders))
    values = [shot.psnr for shot in shots if shot.psnr is not None]
    photos = []
    if capture is not None:  # up to eight training views
        stride = max(1, math.ceil(len(capture.train) / 8))
        photos = [(view.name, pictures.add_photograph(view)) for view in capture.train[::stride]]
    progress(0.8)
    emitters = _optional(run.emitters_json, Emitters) or Emitters((), None)
    environment = emitters.environment if run.environment_exr.exists() else None
    statistics = run.statistics()
    quality = _optional(run.quality_json, QualityNote)
    job = _optional(run.job_json, JobNote) or JobNote({})
    context = {
        "title": run.root.name,
        "version": PRODUCT_VERSION,
        "train_count": len(capture.train) if capture else 0,
        "held_back_count": len(capture.held_back) if capture else 0,
        "shots": shots,
        "mean_psnr": float(np.mean(values)) if values else None,
        "quality": quality,
        "judged_views": _judged_views(run, quality, pictures),
        "photos": photos,
        "exposure": pictures.exposure,
        "error_full": ERROR_FULL,
        "map_rows": _map_rows(run, pictures),
        "fixtures": [
            (name, fixture, swatch(fixture.radiance)) for name, fixture in _named(run, emitters.fixtures)
        ],
        "environment": environment,
        "environment_picture": pictures.add_radiance("environment", run.environment_exr)
        if environment
        else None,
        "stages": statistics.get("stages", []),
        "steps": list(job.seconds.items()),
        "hints": statistics.get("hints", []),
        "numbers": _numbers(statistics),
        "peak_memory_gb": statistics.get("peak_memory_gb"),
        "warnings": job.warnings,
        "settings": [
            (name, getattr(settings, name), item.option.text) for name, item in declared(Settings).items()
        ],
    }
    page = run.report / "index.html"
    write_page(Path(__file__).with_name("template.html"), context, page)
    return page


class _Pictures:
    """The page's pictures: written under names of its own, as names of views may contain any character.

    Attributes:
        capture: of the run; None without one.
        exposure: of all pictures of radiance.
    """

    def __init__(self, run: RunFolder) -> None:
        self.capture = load_capture(run) if run.capture_json.exists() else None
        self.exposure = 1.0
        self._folder, self._count = run.report / "images", 0
        self._known: dict[str, np.ndarray] = {}

    def expose(self, names: set[str]) -> None:
        """Choose the exposure by the photographs of the views `names`, or else by the first one."""
        if self.capture is not None:
            views = [view for view in self.capture.views if view.name in names]
            medians = [np.median(self.photograph(view)) for view in views or self.capture.views[:1]]
            self.exposure = choose_exposure(float(np.median(medians)) if medians else 0.0)

    def photograph(self, view: View) -> np.ndarray:
        """Scene-linear radiance (h, w, 3) of a view, as the page shows it; each is decoded once."""
        if view.name not in self._known:
            self._known[view.name] = narrowed(view.radiance(), PICTURE_WIDTH)
        return self._known[view.name]

    def add(self, kind: str, display: np.ndarray | Path) -> str:
        """Write display values as PNG, or copy such a file; returns the address relative to the page."""
        self._count += 1
        name = f"{self._count:03d}-{kind}.png"
        if isinstance(display, Path):
            self._folder.mkdir(parents=True, exist_ok=True)
            with explained_write_errors(self._folder):
                shutil.copyfile(display, self._folder / name)
        else:
            write_png(self._folder / name, display)
        return f"images/{name}"

    def add_photograph(self, view: View) -> str:
        """Add the photograph of a view."""
        return self.add("photo", to_display(self.photograph(view), self.exposure))

    def add_radiance(self, kind: str, path: Path) -> str:
        """Add an image of radiance."""
        return self.add(kind, to_display(read_radiance(path), self.exposure))


def _optional(path: Path, kind: type[T]) -> T | None:
    """The content of a JSON file; None if there is no such file."""
    return read_document(path, kind, "Repeat the step that writes it.") if path.exists() else None


def _shot(run: RunFolder, render: Render, pictures: _Pictures) -> Shot:
    """One Cycles render with the photograph of its view; only a re-render is compared with it."""
    kind, name, capture, exposure = render.kind, render.view, pictures.capture, pictures.exposure
    path = run.resolve(render.image)
    image = narrowed(read_radiance(path), PICTURE_WIDTH)
    shown = to_display(image, 1.0 if open_picture(path).is_encoded else exposure)
    shot = Shot(_TITLES.get(kind, kind), name, pictures.add("render", shown))
    view = next((view for view in capture.views if view.name == name), None) if capture else None
    if view is None:
        return shot
    photo = means(pictures.photograph(view), image.shape[1], image.shape[0])
    shot = replace(shot, photo=pictures.add("photo", to_display(photo, exposure)))
    if kind != "rerender":
        return shot
    error = pictures.add("error", error_picture(image, photo, exposure))
    held_back = view.split == "held_back"
    return replace(shot, error=error, psnr=psnr(image, photo, exposure), held_back=held_back)


def _judged_views(
    run: RunFolder, quality: QualityNote | None, pictures: _Pictures
) -> list[tuple[str, dict[str, str]]]:
    """Name and pictures, by their titles, of the photographs that judged the result, the worst first."""
    rows = []
    for view in quality.worst_first() if quality else ():
        shown, values = {}, (f", {value:.1f} dB" for value in view.decibels())
        for kind, value in zip(KINDS, ("", *values), strict=True):
            if (path := run.quality / getattr(view, kind)).is_file():
                shown[f"{kind.capitalize()}{value}"] = pictures.add(kind, path)
        rows.append((view.name, shown))
    return rows


def _map_rows(run: RunFolder, pictures: _Pictures) -> list[tuple[str, dict[str, str]]]:
    """The view and the pictures by map's name of each row of material maps that `textures` wrote."""
    rows = []
    maps = _optional(run.results / "maps" / "maps.json", dict)
    for view in maps["views"] if maps else ():
        images = {}
        for name in MAPS:
            values = read_radiance(run.resolve(view[name]))
            # Roughness and metallic are data and are shown unchanged.
            if name in ("base_color", "emission"):
                values = to_display(values, pictures.exposure if name == "emission" else 1.0)
            images[name] = pictures.add(name.replace("_", "-"), values)
        rows.append((view["view"], images))
    return rows


def _named(run: RunFolder, fixtures: Sequence[EmitterFixture]) -> list[tuple[str, EmitterFixture]]:
    """The fixtures with the names that their objects have in Blender."""
    names = [fixture.name for fixture in fixtures]
    if run.room_json.exists():
        names = run_fixture_names(run, fixtures)
    return list(zip(names, fixtures, strict=True))


def swatch(radiance: Sequence[float]) -> str:
    """The hue of a light as a CSS colour whose brightest channel is at its maximum."""
    peak = max(max(radiance), 1e-12)
    values = to_display(np.array(radiance, np.float32) / peak)
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in values)


def _numbers(statistics: dict[str, Any]) -> list[tuple[str, str | int | float]]:
    """Name and value of all other plain values in the statistics."""
    return [
        (name.replace("_", " "), value)
        for name, value in statistics.items()
        if isinstance(value, (str, int, float)) and name != "peak_memory_gb"
    ]
