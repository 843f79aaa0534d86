# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `survey`: what each view sees of the room, problems of its photograph, the available parts,
and where photographs disagree. A quick check for the artist; the estimation does not read it.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from ..surface.room import Room

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
    """Examine all views of FOLDER/capture.json and write FOLDER/survey.json and FOLDER/survey.npz.

    Raises:
        FiptError: where the capture or the mesh can't be read, or a mask can't be used.
    """
    reporter.plan([0.1, 0.7, 0.2])
    reporter.stage("device", "Starting the engine")
    set_variant(arguments.device)
    # Mitsuba's types exist only after the variant is set.
    from ..parts.coverage import coarse_view, fuse_inputs, view_coverage
    from ..parts.labels import automatic_source, label_parts, usable_sources
    from ..parts.linked_masks import link_masks
    from ..surface.room import load_room
    from .agreement import survey_pixels

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
        coverage = view_coverage(room, view, known=in_sight)
        seen[index] = coverage.seen
        in_sight |= coverage.in_sight
        facts = with_misfit(photograph, view, room)
        if not (facts.image_missing or facts.image_problem):
            readable.add(view.name)
        surveyed.append(
            SurveyedView(
                name=view.name,
                warning=view_warning(facts, coverage.room_share),
                image_missing=facts.image_missing,
                room_share=coverage.room_share,
                clipped_share=facts.clipped_share,
                misfit=facts.misfit,
            )
        )
        reporter.progress((index + 1) / len(capture.views))

    reporter.stage("parts", "Finding the parts")
    train = [coarse_view(view) for view in capture.train if view.image.is_file()]
    train = link_masks(folder, replace(room, parts="masks"), train)  # all sources are counted
    labels = {}
    usable = usable_sources(room, train)
    sources = [*usable, "loose"]
    for index, source in enumerate(sources):
        images, triangles = fuse_inputs(room, train, source)
        labels[source] = label_parts(room, source, images, triangles).triangle_part
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


@dataclass(frozen=True)
class PhotographFacts:
    """What is wrong with a photograph, and with the mesh in it.

    Attributes:
        image_missing: whether its file is missing.
        image_problem: why it is unusable, "" where it is not.
        clipped_share: of its pixels that are over-exposed.
        looks_ldr: whether it looks 8-bit although it should be HDR.
        encoded: whether it is no HDR file.
        misfit: distance in pixels of the mesh's edges from its own; None where it can't be measured.
        much_off: whether that is much.
    """

    image_missing: bool = False
    image_problem: str = ""
    clipped_share: float = 0.0
    looks_ldr: bool = False
    encoded: bool = False
    misfit: float | None = None
    much_off: bool = False


def with_misfit(
    photograph: tuple[PhotographFacts, np.ndarray | None], view: View, room: Room
) -> PhotographFacts:
    """The facts of a photograph, with the distance in pixels of the mesh's edges from its own; None where it
    can't be measured.

    Args:
        photograph: by `examined`.
    """
    from .misfit import image_misfit

    facts, image = photograph
    measured = image_misfit(room, view, image)
    if measured is None:
        return facts
    misfit, factor = measured
    return replace(facts, misfit=round(misfit * factor, 2), much_off=misfit > MUCH_OFF)


def examined(view: View) -> tuple[PhotographFacts, np.ndarray | None]:
    """The facts of a photograph, and the image that is compared with the mesh, None without any.

    The photograph on the grid of its coverage is kept in memory.
    """
    from ..parts.coverage import coarse_view
    from .misfit import edge_image

    try:
        pixels = read_radiance(view.image)
        if pixels.shape[:2] != (view.height, view.width):
            size = f"{pixels.shape[1]} x {pixels.shape[0]}"
            problem = f"is {size} pixels, not {view.width} x {view.height}"
            return PhotographFacts(image_problem=problem), None
        statistics = pixel_statistics(view.image, pixels)
    except FiptError as error:
        missing = error.code == "image-missing"
        return PhotographFacts(missing, "" if missing else error.text), None
    coarse_view(view).keep(pixels)
    clipped, looks_ldr = statistics.clipped, statistics.looks_ldr
    if view.encoded:
        codes = srgb_encoded(pixel_sample(pixels)) * 255.0
        clipped, looks_ldr = float(is_clipped(codes).mean()), False  # the import has warned
    facts = PhotographFacts(clipped_share=clipped, looks_ldr=looks_ldr, encoded=view.encoded)
    return facts, edge_image(view, pixels)


def view_warning(facts: PhotographFacts, room_share: float) -> str:
    """The most serious problem of a view in a few words, "" where there is none.

    Args:
        facts: of its photograph.
        room_share: of its pixels that see the room.
    """
    if facts.image_missing:
        return "the photograph is missing"
    if facts.image_problem:
        return f"the photograph can't be used: {facts.image_problem}"
    if room_share == 0.0:
        return "sees nothing of the room"
    if room_share < LITTLE_SEEN:
        return f"sees the room in only {100.0 * room_share:.0f} % of its pixels"
    if facts.much_off:
        return f"the mesh is {facts.misfit:.1f} pixels off in this view"
    if facts.looks_ldr:
        share = 100.0 * facts.clipped_share
        clipped = f"; {share:.1f} % of its pixels are clipped" if share else ""
        return f"looks like an 8-bit photograph, without the true radiance of lamps{clipped}"
    if facts.clipped_share > (MUCH_CLIPPED_ENCODED if facts.encoded else MUCH_CLIPPED):
        return f"{100.0 * facts.clipped_share:.1f} % of its pixels look over-exposed"
    return ""
