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
from .command import STEPS
from .facts import (
    FinishedStep,
    MergedImage,
    MergeFacts,
    ReadFacts,
    ResponseFacts,
    ScaleFacts,
    SolveFacts,
    VignettingFacts,
    read_facts,
    shutter_text,
)
from .preparation import Group, Preparation, PreparationFolder

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
class Plan:
    """The cameras from above, in pixels of the plan."""

    # width, height: of the plan
    width: float
    height: float
    # Of each camera its name, its place (2,), and the tip of an arrow along its view (2,)
    arrows: tuple[tuple[str, list[float], list[float]], ...]
    bar: float  # length of a bar
    length: float  # what the bar is in units of the model


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the page shows besides the facts of the steps before."""
    return [asdict(group) for group in preparation.groups]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> None:
    """The step `report`; it has no facts of its own."""
    write_report(folder, preparation, reporter.progress)


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
    """
    merge = read_facts(folder, "merge", MergeFacts) or MergeFacts()
    read = read_facts(folder, "read", ReadFacts) or ReadFacts()
    solve = read_facts(folder, "solve", SolveFacts)
    vignetting = read_facts(folder, "vignetting", VignettingFacts) or VignettingFacts()
    finished = {name: read_facts(folder, name, FinishedStep) for name in STEPS if name != "report"}
    steps = {name: step for name, step in finished.items() if step is not None}
    exposure = _exposure([folder.image(group) for group in preparation.used_groups])
    found = colmap.find(folder.root)
    merged = {image.name: image for image in merge.images}
    cameras = {view.name: view for view in (solve.registered if solve else ())}
    rows: list[dict[str, Any]] = []
    for index, group in enumerate(preparation.groups):
        row = {
            "group": group,
            "photographs": [
                (Path(item.path).name, shutter_text(item.shutter)) for item in preparation.of(group)
            ],
            "picture": _picture(folder, group, index, exposure) if group.used else "",
            "merged": merged.get(group.name, MergedImage(group.name)),
            "camera": cameras.get(group.name),
        }
        rows.append(row)
        progress(0.95 * (index + 1) / len(preparation.groups))
    context = {
        "title": folder.root.name,
        "version": PRODUCT_VERSION,
        "stopped": stopped,
        "rows": rows,
        "used": [row for row in rows if row["group"].used],
        "solve": solve,
        "meters_per_unit": (read_facts(folder, "scale", ScaleFacts) or ScaleFacts()).meters_per_unit,
        "left_out": [*(solve.left_out if solve else ()), *read.skipped],
        "lenses": [(lens.lens, lens.corner, _SOURCES.get(lens.source, "")) for lens in vignetting.lenses],
        "plan": make_plan(colmap.read(found, CaptureOptions())) if found else None,
        "curves": _curves(merge.response),
        "uncertainty": merge.response.uncertainty if merge.response else None,
        "curve_size": _CURVE_SIZE,
        "warnings": [warning for step in steps.values() for warning in step.messages],
        "times": [(name, step.seconds) for name, step in steps.items()],
    }
    page = folder.report / "index.html"
    write_page(Path(__file__).with_name("template.html"), context, page)
    return page


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
        with Image.open(mask) as image:  # a pixel in which any of the mask's is clipped
            size = display.shape[1], display.shape[0]
            clipped = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX)) > 0
        display[clipped] = CLIPPED_COLOR
    address = f"images/{index:04d}.jpg"
    write_jpeg(folder.report / address, display)
    return address


def make_plan(rig: Rig) -> Plan | None:
    """The cameras of a rig with Z up, seen from above; None without cameras."""
    if not rig.views:
        return None
    poses = np.stack([view.camera_to_world for view in rig.views])
    places, forward = poses[:, :2, 3], poses[:, :2, 2]
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    longest = max(float(extent.max()), 1e-9)
    scale = (420.0 - 2.0 * _PLAN_MARGIN) / longest
    width, height = extent * scale + 2.0 * _PLAN_MARGIN
    pixels = (places - low) * scale + _PLAN_MARGIN
    ends = np.stack([pixels, pixels + 14.0 * forward]) * [1.0, -1.0] + [0.0, height]  # Y points down
    arrows = zip([view.name for view in rig.views], *ends.tolist(), strict=True)
    length = float(10.0 ** np.floor(np.log10(longest)))
    return Plan(float(width), float(height), tuple(arrows), length * scale, length)


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
