# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report page of a prepared capture: its images, brackets, cameras and messages; readable offline.

Any step may be missing (only `read` has run, or the job was stopped); the page shows what exists.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..core.capture.averaging import narrowed
from ..core.capture.formats import colmap
from ..core.capture.images import read_radiance
from ..core.capture.options import CaptureOptions
from ..core.capture.rig import Rig
from ..core.report.comparison import to_display
from ..core.report.html import write_page
from ..core.report.pictures import write_jpeg
from ..core.run.errors import FiptError
from ..core.run.messages import Reporter
from ..core.run.runfolder import PRODUCT_VERSION
from .facts import (
    FinishedStep,
    MergedImage,
    MergeFacts,
    ReadFacts,
    ReportFacts,
    ResponseFacts,
    ScaleFacts,
    SolveFacts,
    VignettingFacts,
    read_facts,
    shutter_text,
)
from .preparation import Group, Preparation, PreparationFolder

_STEPS = ("read", "merge", "solve", "vignetting", "scale")
_SOURCES = {
    "database": "corrected, by the lens database",
    "overlap": "corrected, measured where views overlap",
    "none": "nothing to correct: measured where views overlap",
    "unknown": "not corrected: neither the files nor the views tell it",
}
PICTURE_WIDTH = 400  # pixels, of the pictures on the page
CLIPPED_COLOR = (1.0, 0.0, 1.0)
_PLAN_MARGIN = 24.0  # pixels around the cameras' plan
_CURVE_SIZE = 200.0  # pixels along an edge of the picture of a response


@dataclass(frozen=True)
class GroupRow:
    """One group on the page; values that no step has measured are None."""

    name: str
    used: bool
    photographs: tuple[str, ...]
    shutters: tuple[str, ...]
    picture: str
    clipped_share: float | None
    moved_share: float | None
    shift_pixels: float | None
    state: str
    points: float | None
    reprojection_error: float | None


@dataclass(frozen=True)
class Arrow:
    """A camera on the plan: from its place along its view, in pixels of the plan."""

    name: str
    x: float
    y: float
    tip_x: float
    tip_y: float


@dataclass(frozen=True)
class Plan:
    """The cameras from above; `length` is what `bar` pixels of it are, in units of the model."""

    width: float
    height: float
    arrows: tuple[Arrow, ...]
    bar: float
    length: float


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the page shows besides the facts of the steps before."""
    return [asdict(group) for group in preparation.groups]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> ReportFacts:
    """The step `report`; it has no facts of its own."""
    write_report(folder, preparation, reporter.progress)
    return ReportFacts()


def write_report(
    folder: PreparationFolder,
    preparation: Preparation,
    progress: Callable[[float], None] = lambda fraction: None,
    stopped: FiptError | None = None,
) -> Path:
    """Write report/index.html and its pictures; returns the page's path.

    Args:
        folder, preparation: of the capture.
        progress: called with the finished share.
        stopped: the error that has ended the steps, if one has.

    Raises:
        FiptError: ``file-damaged``, ``image-unreadable``, ``disk-full`` or ``run-unwritable``.
    """
    merge = read_facts(folder, "merge", MergeFacts) or MergeFacts()
    solve = read_facts(folder, "solve", SolveFacts)
    vignetting = read_facts(folder, "vignetting", VignettingFacts) or VignettingFacts()
    scale = read_facts(folder, "scale", ScaleFacts) or ScaleFacts()
    finished = {name: read_facts(folder, name, FinishedStep) for name in _STEPS}
    steps = {name: step for name, step in finished.items() if step is not None}
    exposure = _exposure([folder.image(group) for group in preparation.used_groups])
    rows = []
    for index, group in enumerate(preparation.groups):
        picture = _picture(folder, group, index, exposure) if group.used else ""
        rows.append(_row(preparation, group, picture, merge, solve))
        progress(0.95 * (index + 1) / len(preparation.groups))
    used = [row for row in rows if row.used]
    context = {
        "title": folder.root.name,
        "version": PRODUCT_VERSION,
        "stopped": stopped,
        "rows": rows,
        "used": used,
        "photograph_count": sum(len(row.photographs) for row in used),
        "registered_count": sum(row.state == "registered" for row in rows) if solve else None,
        "reprojection_error": solve.reprojection_error if solve else None,
        "meters_per_unit": scale.meters_per_unit,
        "left_out": _left_out(folder, solve),
        "lenses": [(lens.lens, lens.corner, _SOURCES.get(lens.source, "")) for lens in vignetting.lenses],
        "plan": _plan(folder.root),
        "curves": _curves(merge.response),
        "uncertainty": merge.response.uncertainty if merge.response else None,
        "curve_size": _CURVE_SIZE,
        "warnings": [warning for step in steps.values() for warning in step.messages],
        "times": [(name, step.seconds) for name, step in steps.items()],
    }
    page = folder.report / "index.html"
    write_page(Path(__file__).with_name("template.html"), context, page)
    return page


def _left_out(folder: PreparationFolder, solve: SolveFacts | None) -> list[tuple[str, str]]:
    """Views without a camera and files that are no photographs, each with the reason."""
    skipped = (read_facts(folder, "read", ReadFacts) or ReadFacts()).skipped
    views = solve.left_out if solve else ()
    named = [(view.name, f"{view.reason} {view.remedy}".strip()) for view in views]
    return named + [(file.path, file.reason) for file in skipped]


def _exposure(images: Sequence[Path]) -> float:
    """One exposure for all pictures, from a few of the images."""
    existing = [path for path in images if path.is_file()]
    step = max(1, len(existing) // 5)
    medians = [float(np.median(small(path))) for path in existing[::step]]
    median = float(np.median(medians)) if medians else 0.0
    # The scale of radiance is arbitrary: the median becomes middle gray.
    return 0.18 / median if median > 0.0 else 1.0


def small(path: Path, width: int = PICTURE_WIDTH) -> np.ndarray:
    """A radiance image at a width of pixels at most, (H, W, 3) f32.

    Large images are first thinned out to twice that width, because averaging all pixels takes several times
    the image's memory.
    """
    image = read_radiance(path)
    step = max(1, image.shape[1] // (2 * width))
    return narrowed(image[::step, ::step], width)


def _picture(folder: PreparationFolder, group: Group, index: int, exposure: float) -> str:
    """The picture of a merged image, clipped pixels in magenta; its address on the page, "" for none."""
    path, mask = folder.image(group), folder.clipped_mask(group)
    if not path.is_file():
        return ""
    display = to_display(small(path), exposure)
    if mask.is_file():
        display[_clipped_pixels(mask, display.shape)] = CLIPPED_COLOR
    address = f"images/{index:04d}.jpg"
    write_jpeg(folder.report / address, display)
    return address


def _clipped_pixels(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Pixels (H, W) of the picture in which any pixel of the mask is clipped."""
    try:
        with Image.open(path) as image:
            mask = image.convert("L").resize((shape[1], shape[0]), Image.Resampling.BOX)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise FiptError("file-damaged", f"{path} can't be read ({error}).", "Merge again.") from None
    return np.asarray(mask) > 0


def _row(
    preparation: Preparation, group: Group, picture: str, merge: MergeFacts, solve: SolveFacts | None
) -> GroupRow:
    merged = next((image for image in merge.images if image.name == group.name), MergedImage(group.name))
    registered = solve.registered if solve else ()
    view = next((view for view in registered if view.name == group.name), None)
    state = "" if not group.used or solve is None else "registered" if view else "not registered"
    photographs = preparation.of(group)
    return GroupRow(
        name=group.name,
        used=group.used,
        photographs=tuple(Path(photograph.path).name for photograph in photographs),
        shutters=tuple(shutter_text(photograph.shutter) for photograph in photographs),
        picture=picture,
        clipped_share=merged.clipped_share,
        moved_share=merged.moved_share,
        shift_pixels=merged.shift_pixels,
        state=state,
        points=view.points if view else None,
        reprojection_error=view.reprojection_error if view else None,
    )


def _plan(capture: Path) -> Plan | None:
    """The solved cameras from above, or None without a model."""
    found = colmap.find(capture)
    return None if found is None else make_plan(colmap.read(found, CaptureOptions()))


def make_plan(rig: Rig) -> Plan | None:
    """The cameras of a rig with Z up, seen from above; None without cameras."""
    if not rig.views:
        return None
    poses = np.stack([view.camera_to_world for view in rig.views])
    places, forward = poses[:, :2, 3], poses[:, :2, 2]
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    scale = (420.0 - 2.0 * _PLAN_MARGIN) / max(float(extent.max()), 1e-9)
    size = extent * scale + 2.0 * _PLAN_MARGIN
    pixels = (places - low) * scale + _PLAN_MARGIN
    arrows = []
    for view, (x, y), direction in zip(rig.views, pixels, forward, strict=True):
        tip = np.array([x, y]) + 14.0 * direction
        arrows.append(Arrow(view.name, float(x), float(size[1] - y), float(tip[0]), float(size[1] - tip[1])))
    length = 10.0 ** np.floor(np.log10(max(float(extent.max()), 1e-9)))
    return Plan(float(size[0]), float(size[1]), tuple(arrows), float(length * scale), float(length))


def _curves(response: ResponseFacts | None) -> list[tuple[str, str]]:
    """Colour and points (SVG) of the recovered response of each channel: pixel value against exposure."""
    if response is None:
        return []
    curves = []
    for color, values in zip(("#d33", "#3a3", "#36c"), response.curves, strict=False):
        array = np.asarray(values, np.float64)
        array = array / max(float(array.max(initial=0.0)), 1e-12)
        x = np.clip(array, 0.0, 1.0) * _CURVE_SIZE
        y = _CURVE_SIZE - np.linspace(0.0, _CURVE_SIZE, len(array))
        curves.append((color, " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))))
    return curves
