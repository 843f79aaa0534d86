# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `survey`: what each view sees of the room, what is wrong with its photograph, which parts
there are. Quick, for the artist to look at before an estimation; the estimation does not read it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.checks import pixel_statistics
from ..capture.images import read_radiance
from ..capture.views import View, load_capture
from ..device.variant import set_variant
from ..job.errors import FiptError
from ..job.messages import Reporter
from ..job.runfolder import RunFolder, atomic_path, write_json

SURVEY_FORMAT = "fipt-survey"
SURVEY_VERSION = 1
LITTLE_SEEN = 0.5  # share of a photograph's pixels; what looks past the room tells nothing of it
MUCH_CLIPPED = 0.002


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("folder", type=Path, help="folder with capture.json, room.npz and room.json")
    parser.add_argument("--device", default="auto", help="auto, cuda or llvm")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Look at all views of FOLDER/capture.json and write FOLDER/survey.json and survey.npz beside it.

    Raises:
        FiptError: where capture or mesh can't be read, or a mask can't be used.
    """
    reporter.plan([0.1, 0.7, 0.2])
    reporter.stage("device", "Starting the engine")
    set_variant(arguments.device)
    # Mitsuba's names exist once the variant is set.
    from .coverage import fuse_inputs, trace_view
    from .labels import choose_source, label_parts, usable_sources
    from .room import load_room

    folder = RunFolder(arguments.folder)
    capture, room = load_capture(folder), load_room(folder)
    reporter.stage("views", "Looking through every camera")
    entries: list[dict[str, Any]] = []
    seen = np.zeros((len(capture.views), len(room.triangles)), bool)
    around = np.zeros(len(room.triangles), bool)
    for index, view in enumerate(capture.views):
        sight = trace_view(room, view)
        seen[index] = sight.seen
        around |= sight.around
        entries.append({"name": view.name, "room_share": sight.room_share, **look_at_photograph(view)})
        entries[-1]["warning"] = judge_view(entries[-1])
        reporter.progress((index + 1) / len(capture.views))

    reporter.stage("parts", "Telling parts apart")
    train = [view for view in capture.train if view.image.is_file()]
    labels = {}
    sources = [*usable_sources(room, train), "loose"]
    for index, source in enumerate(sources):
        images, triangles = fuse_inputs(room, train, source)
        labels[source] = label_parts(room, source, images, triangles).triangle_part
        reporter.progress((index + 1) / len(sources))

    with atomic_path(folder.root / "survey.npz") as temporary:
        np.savez_compressed(
            temporary,
            seen=np.packbits(seen, axis=1),
            # What is hidden from wherever the cameras stood, such as the walls' outer sides, is no gap.
            areas=np.where(around, room.areas, 0.0).astype(np.float32),
            **{f"parts_{source}": part for source, part in labels.items()},
        )
    write_json(
        folder.root / "survey.json",
        {
            "format": SURVEY_FORMAT,
            "version": SURVEY_VERSION,
            "views": entries,
            "parts": {
                "auto": choose_source(replace(room, parts="auto"), train),
                "counts": {source: len(np.unique(part[part >= 0])) for source, part in labels.items()},
            },
        },
    )
    reporter.done([str(folder.root / name) for name in ("survey.json", "survey.npz")])


def look_at_photograph(view: View) -> dict[str, Any]:
    """What its file tells: whether it is missing or unusable, its over-exposed share, whether it is 8-bit."""
    result = {"image_missing": False, "image_problem": "", "clipped_share": 0.0, "looks_ldr": False}
    try:
        pixels = read_radiance(view.image)
        if pixels.shape[:2] != (view.height, view.width):
            size = f"{pixels.shape[1]} x {pixels.shape[0]}"
            return result | {"image_problem": f"is {size} pixels, not {view.width} x {view.height}"}
        statistics = pixel_statistics(view.image, pixels)
    except FiptError as error:
        missing = error.code == "image-missing"
        return result | {"image_missing": missing, "image_problem": "" if missing else error.text}
    return result | {"clipped_share": statistics.clipped, "looks_ldr": statistics.looks_ldr}


def judge_view(facts: dict[str, Any]) -> str:
    """The worst that can be said about a view in few words, "" where there is nothing."""
    if facts["image_missing"]:
        return "the photograph is missing"
    if facts["image_problem"]:
        return f"the photograph can't be used: {facts['image_problem']}"
    if facts["room_share"] == 0.0:
        return "sees nothing of the room"
    if facts["room_share"] < LITTLE_SEEN:
        return f"sees the room in only {100.0 * facts['room_share']:.0f} % of its pixels"
    if facts["looks_ldr"]:
        return "looks like an 8-bit photograph, without the true radiance of lamps"
    if facts["clipped_share"] > MUCH_CLIPPED:
        return f"{100.0 * facts['clipped_share']:.1f} % of its pixels look over-exposed"
    return ""
