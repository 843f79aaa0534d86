"""Engine command `survey`: what each view sees of the room, problems of its photograph, the available parts,
and where photographs disagree. A quick check for the artist; the estimation does not read it.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..capture.checks import pixel_sample, pixel_statistics
from ..capture.encoded import srgb_encoded
from ..capture.images import read_radiance
from ..capture.views import View, decoded, load_capture
from ..device.variant import set_variant
from ..radiometry.inversion import MUCH_CLIPPED as MUCH_CLIPPED_ENCODED
from ..radiometry.inversion import is_clipped
from ..run.contents import Box, SurveyedParts, SurveyedView, SurveyNote
from ..run.errors import FiptError
from ..run.messages import Reporter
from ..run.run_files import SurveyArrays
from ..run.runfolder import RunFolder, write_json
from ..run.store import write_arrays

LITTLE_SEEN = 0.5  # share of a photograph's pixels that see the room
MUCH_CLIPPED = 0.002  # share of a photograph's pixels
# Boxes in the air in which photographs show something: points that are tested, least share of all
# disagreement that a box explains, and most boxes.
AIR_POINTS, LEAST_MISSING, MOST_MISSING = 200_000, 0.002, 8
MUCH_OFF = 2.0  # pixels between the edges of mesh and photograph; chance gives up to 1.5 in a poor view


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("folder", type=Path, help="folder with capture.json, room.npz and room.json")
    parser.add_argument("--device", default="auto", help="auto, cuda or llvm")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Examine all views of FOLDER/capture.json and write FOLDER/survey.json and FOLDER/survey.npz."""
    reporter.plan([0.1, 0.7, 0.2])
    reporter.stage("device", "Starting the engine")
    set_variant(arguments.device)
    # Mitsuba's types exist only after the variant is set.
    from ..parts.coverage import coarse_triangles, coarse_view, view_coverage
    from ..parts.labels import IMAGE_SOURCES, automatic_source, source_parts, usable_sources
    from ..parts.linked_masks import link_masks, with_masks
    from ..surface.room import load_room
    from .agreement import survey_pixels
    from .misfit import image_misfit

    folder = RunFolder(arguments.folder)
    capture = load_capture(folder)
    room = load_room(folder, cleaned=False)  # the artist judges the mesh, also after `complete`
    reporter.stage("views", "Finding what each camera sees")
    surveyed: list[SurveyedView] = []
    seen = np.zeros((len(capture.views), len(room.triangles)), bool)
    in_sight = np.zeros(len(room.triangles), bool)
    # The next photographs are decoded while the mesh is compared with one.
    photographs = decoded(examined, capture.views)
    readable: set[str] = set()  # names of views
    for index, (view, photograph) in enumerate(zip(capture.views, photographs, strict=True)):
        seen[index], visible, room_share = view_coverage(room, view, known=in_sight)
        in_sight |= visible
        if not photograph.unusable:
            readable.add(view.name)
        misfit, reduced = image_misfit(room, view, photograph.image) or (None, 1)
        found = None if misfit is None else round(misfit * reduced, 2)
        much_off = misfit is not None and misfit > MUCH_OFF
        off = f"the mesh is {found:.1f} pixels off in this view" if much_off else ""
        warning, share = view_warning(photograph, room_share, off), photograph.clipped_share
        surveyed.append(SurveyedView(view.name, warning, photograph.missing, room_share, share, found))
        reporter.progress((index + 1) / len(capture.views))

    reporter.stage("parts", "Finding the parts")
    train = [coarse_view(view) for view in capture.train if view.image.is_file()]
    linked = link_masks(replace(room, parts="masks"), train, folder.linked)  # all sources are counted
    train = with_masks(train, linked)
    labels = {}
    usable = usable_sources(room, train)
    sources = [*usable, "loose"]
    by_images = not set(IMAGE_SOURCES).isdisjoint(usable)
    triangles = [coarse_triangles(room, view) for view in train] if by_images else []
    for index, source in enumerate(sources):
        labels[source] = source_parts(room, source, train, triangles).triangle_part
        reporter.progress((index + 1) / (len(sources) + 1))
    pixels = survey_pixels(room, [view for view in train if view.name in readable])
    missing: list[Box] = []
    if pixels is not None:
        boxes = pixels.boxes(room.bounds, AIR_POINTS)
        shown = itertools.takewhile(
            lambda disagreeing: disagreeing[2] >= LEAST_MISSING, itertools.islice(boxes, MOST_MISSING)
        )
        missing = [Box(tuple(low.tolist()), tuple(high.tolist())) for (low, high), _, _ in shown]

    # Surfaces hidden from all camera positions, such as the outer sides of walls, are not gaps.
    areas = np.where(in_sight, room.areas, 0.0).astype(np.float32)
    arrays = SurveyArrays(np.packbits(seen, axis=1), areas, labels)
    write_arrays(folder.root / "survey.npz", arrays)
    counts = {source: len(np.unique(part[part >= 0])) for source, part in labels.items()}
    parts = SurveyedParts(automatic_source(room, usable), counts)
    write_json(folder.root / "survey.json", SurveyNote(tuple(surveyed), parts, tuple(missing)))
    reporter.done([str(folder.root / name) for name in ("survey.json", "survey.npz")])


@dataclass(frozen=True, eq=False)
class PhotographFacts:
    """What is wrong with a photograph."""

    missing: bool = False  # whether its file is missing
    unusable: str = ""  # why it can't be used, "" if it can
    clipped_share: float = 0.0  # 0..1, of its pixels that are over-exposed
    flaw: str = ""  # what is wrong with its radiance, "" for nothing
    # (h, w) what is compared with the mesh (:func:`.edge_image`), None without any
    image: np.ndarray | None = None


def examined(view: View) -> PhotographFacts:
    """The facts of a photograph, which is kept in memory on the grid of its coverage."""
    from ..parts.coverage import coarse_view
    from .misfit import edge_image

    problem = "the photograph can't be used: {}".format
    try:
        pixels = read_radiance(view.image)
        if pixels.shape[:2] != (view.height, view.width):
            size = f"{pixels.shape[1]} x {pixels.shape[0]}"
            return PhotographFacts(unusable=problem(f"is {size} pixels, not {view.width} x {view.height}"))
        statistics = pixel_statistics(view.image, pixels)
    except FiptError as error:
        missing = error.code == "image-missing"
        return PhotographFacts(missing, "the photograph is missing" if missing else problem(error.text))
    coarse_view(view).keep(pixels)
    clipped, flaw = statistics.clipped, ""
    if view.encoded:
        codes = srgb_encoded(pixel_sample(pixels)) * 255.0
        clipped = float(is_clipped(codes).mean())
    if statistics.looks_ldr and not view.encoded:  # of encoded ones, the import has warned
        share = f"; {100.0 * clipped:.1f} % of its pixels are clipped" if clipped else ""
        flaw = f"looks like an 8-bit photograph, without the true radiance of lamps{share}"
    elif clipped > (MUCH_CLIPPED_ENCODED if view.encoded else MUCH_CLIPPED):
        flaw = f"{100.0 * clipped:.1f} % of its pixels look over-exposed"
    return PhotographFacts(clipped_share=clipped, flaw=flaw, image=edge_image(view, pixels))


def view_warning(photograph: PhotographFacts, room_share: float, off: str = "") -> str:
    """The most serious problem of a view in a few words, "" where there is none.

    Args:
        room_share: 0..1, of its pixels that see the room.
        off: that the mesh is off in the view, "" if it is not.
    """
    if photograph.unusable:
        return photograph.unusable
    if room_share == 0.0:
        return "sees nothing of the room"
    if room_share < LITTLE_SEEN:
        return f"sees the room in only {100.0 * room_share:.0f} % of its pixels"
    return off or photograph.flaw
