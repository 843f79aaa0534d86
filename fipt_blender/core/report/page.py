# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `report RUN`: one HTML page with its images beside it, readable offline.

Every part of a run may be missing (a run without renders, or one that was stopped); the page shows what
is there.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from ..capture.images import read_radiance
from ..capture.views import Capture, load_capture
from ..job.messages import Reporter
from ..job.runfolder import PRODUCT_VERSION, RunFolder, atomic_path, read_json
from ..job.settings import Settings
from .comparison import (
    ERROR_FULL,
    choose_exposure,
    error_picture,
    psnr,
    resize_to,
    to_display,
)
from .pictures import write_png

MAPS = ("base_color", "roughness", "metallic", "emission")
MAX_PHOTOS = 8
_KINDS = {
    "rerender": "A view rendered again",
    "relight": "Estimated lights off, a new area light on",
    "insert": "With an inserted object",
    "composite": "An inserted object in the photograph",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="the run folder")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Write report/index.html of a run folder."""
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
    settings = run.read()
    capture = load_capture(run) if run.capture_json.exists() else None
    album = _Album(run)
    renders = _optional(run.renders_json).get("renders", [])
    exposure = _exposure(capture, {entry["view"] for entry in renders})
    shots = []
    for index, entry in enumerate(renders):
        shots.append(_shot(run, capture, entry, album, exposure))
        progress(0.6 * (index + 1) / len(renders))
    values = [shot["psnr"] for shot in shots if shot["psnr"] is not None]
    photos = [] if capture is None else _photos(capture, album, exposure)
    progress(0.8)
    emitters = _optional(run.emitters_json)
    statistics = _optional(run.statistics_json)
    context = {
        "title": run.root.name,
        "version": PRODUCT_VERSION,
        "capture": capture,
        "counts": _counts(capture),
        "shots": shots,
        "mean_psnr": float(np.mean(values)) if values else None,
        "photos": photos,
        "exposure": exposure,
        "error_full": ERROR_FULL,
        "map_rows": _maps(run, album, exposure),
        "fixtures": [_fixture(entry) for entry in emitters.get("fixtures", [])],
        "environment": _environment(run, emitters.get("environment"), album, exposure),
        "stages": _stages(statistics),
        "steps": _steps(run),
        "numbers": _numbers(statistics),
        "peak_memory_gb": statistics.get("peak_memory_gb"),
        "warnings": _warnings(run),
        "settings": [
            (item.name, getattr(settings, item.name), item.metadata["help"]) for item in fields(Settings)
        ],
    }
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["duration"] = format_duration
    template = environment.from_string(Path(__file__).with_name("template.html").read_text(encoding="utf-8"))
    page = run.report / "index.html"
    with atomic_path(page) as temporary:
        temporary.write_text(template.render(context), encoding="utf-8")
    return page


class _Album:
    """Writes the page's images under names of its own: those of views may hold anything."""

    def __init__(self, run: RunFolder) -> None:
        self._folder = run.report / "images"
        self._count = 0

    def add(self, kind: str, display: np.ndarray) -> str:
        """Write display values as PNG; returns the address relative to the page."""
        self._count += 1
        name = f"{self._count:03d}-{kind}.png"
        write_png(self._folder / name, display)
        return f"images/{name}"


def _optional(path: Path) -> dict[str, Any]:
    return read_json(path) if path.exists() else {}


def _exposure(capture: Capture | None, names: set[str]) -> float:
    if capture is None:
        return 1.0
    views = [view for view in capture.views if view.name in names] or list(capture.views[:1])
    return choose_exposure(float(np.median([np.median(view.radiance()) for view in views])) if views else 0.0)


def _shot(
    run: RunFolder, capture: Capture | None, entry: Mapping[str, Any], album: _Album, exposure: float
) -> dict[str, Any]:
    """One Cycles render with the photograph of its view; only a re-render is compared with it."""
    kind, name = str(entry["kind"]), str(entry["view"])
    image = read_radiance(run.resolve(entry["image"]))
    shot = {"kind": kind, "title": _KINDS.get(kind, kind), "view": name}
    shot["image"] = album.add("render", to_display(image, exposure))
    view = next((view for view in capture.views if view.name == name), None) if capture else None
    if view is None:
        return {**shot, "photo": None, "error": None, "psnr": None}
    photo = resize_to(view.radiance(), image.shape[1], image.shape[0])
    shot["photo"] = album.add("photo", to_display(photo, exposure))
    if kind != "rerender":
        return {**shot, "error": None, "psnr": None}
    shot["error"] = album.add("error", error_picture(image, photo, exposure))
    return {**shot, "psnr": psnr(image, photo, exposure), "held_back": view.split == "held_back"}


def _photos(capture: Capture, album: _Album, exposure: float) -> list[dict[str, str]]:
    every = max(1, math.ceil(len(capture.train) / MAX_PHOTOS))
    return [
        {"name": view.name, "image": album.add("photo", to_display(view.radiance(), exposure))}
        for view in capture.train[::every]
    ]


def _counts(capture: Capture | None) -> dict[str, int]:
    if capture is None:
        return {"train": 0, "held_back": 0}
    return {"train": len(capture.train), "held_back": len(capture.held_back)}


def _maps(run: RunFolder, album: _Album, exposure: float) -> list[dict[str, Any]]:
    """Rows of the material maps that `textures` wrote."""
    rows = []
    for entry in _optional(run.results / "maps" / "maps.json").get("views", []):
        images = {}
        for name in MAPS:
            values = read_radiance(run.resolve(entry[name]))
            # Roughness and metallic are data: shown as they are.
            if name in ("base_color", "emission"):
                values = to_display(values, exposure if name == "emission" else 1.0)
            images[name] = album.add(name.replace("_", "-"), values)
        rows.append({"view": str(entry["view"]), "images": images})
    return rows


def _fixture(entry: Mapping[str, Any]) -> dict[str, Any]:
    radiance = [float(value) for value in entry["radiance"]]
    return {
        "name": str(entry["name"]),
        "triangles": len(entry.get("triangles", [])),
        "radiance": radiance,
        "area": float(entry.get("area", 0.0)),
        "power": [float(value) for value in entry.get("power", [])],
        "swatch": swatch(radiance),
    }


def swatch(radiance: list[float]) -> str:
    """The hue of a light as a CSS colour, its brightest channel at full."""
    peak = max(max(radiance), 1e-12)
    values = to_display(np.array(radiance, np.float32) / peak)
    return "#" + "".join(f"{round(255 * float(value)):02x}" for value in values)


def _environment(
    run: RunFolder, entry: Mapping[str, Any] | None, album: _Album, exposure: float
) -> dict[str, Any] | None:
    if not entry:
        return None
    if not run.environment_exr.exists():
        return None
    image = album.add("environment", to_display(read_radiance(run.environment_exr), exposure))
    return {"image": image, "observed_share": entry.get("observed_share")}


def _stages(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    stages = []
    for entry in statistics.get("stages", []):
        seconds, rays = float(entry.get("seconds") or 0.0), entry.get("rays")
        stages.append(
            {
                "name": str(entry.get("name", "")),
                "seconds": seconds,
                "rays": rays,
                "mrays_per_second": rays / seconds / 1e6 if rays and seconds > 0.0 else None,
            }
        )
    return stages


def _steps(run: RunFolder) -> list[tuple[str, float]]:
    steps = _optional(run.root / "steps.json").get("steps", {})
    return [(name, float(entry["seconds"])) for name, entry in steps.items() if entry.get("finished")]


def _warnings(run: RunFolder) -> list[dict[str, str]]:
    steps = _optional(run.root / "steps.json").get("steps", {})
    return [warning for entry in steps.values() for warning in entry.get("warnings", [])]


def _numbers(statistics: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Whatever else the engine counted, as long as it is a plain value."""
    return [
        (name.replace("_", " "), value)
        for name, value in statistics.items()
        if isinstance(value, (str, int, float)) and not isinstance(value, bool) and name != "peak_memory_gb"
    ]


def format_duration(seconds: float) -> str:
    """Seconds for people: "12.3 s", "4 min 5 s"."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    whole = int(seconds + 0.5)
    return f"{whole // 60} min {whole % 60} s"
