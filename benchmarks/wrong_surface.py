# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that see the wrong surface of a scan, and light that leaves: `wrong_surface.py CAPTURE RUN`.

RUN is a run folder that was prepared with a scan of a capture with ground truth (benchmarks/prepared.py). It
is completed without each mechanism, with each alone and with all, and rays through the pixels of all views
are compared with those on the exact mesh. A row takes seconds, as nothing is estimated.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.disturb import read_obj
from benchmarks.trial_run import CLEANED_FILES, copy_files
from fipt_blender.core import conventions
from fipt_blender.core.capture.light_views import light_views
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings, make_settings

if TYPE_CHECKING:
    from fipt_blender.core.surface.room import Room

# The settings that say what photographs complete.
KINDS = ("panes", "lost_surfaces", "torn_parts")
LAMP_RAYS = 200_000
START = 1e-4  # metres before a lamp at which its rays start


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact mesh.

    Attributes:
        room: in Blender's world.
        part: (T,) int of each triangle.
        emits: (T,) bool.
    """

    room: Room
    part: np.ndarray
    emits: np.ndarray


@dataclass(frozen=True)
class Wrong:
    """Shares of all pixels, or of the rays of lamps.

    Attributes:
        behind: a surface more than the tolerance behind the true one, or none at all.
        before: one as far before it, or where there is none.
        border: those of both that are right for a pixel beside them.
        leaves: rays of lamps that pass the true surface by more than the tolerance.
        parts: part of the true surface to the number of pixels that see something behind it, off borders.
    """

    behind: float
    before: float
    border: float
    leaves: float
    parts: Mapping[int, int]


def read_truth(capture: Path, world_from_source: np.ndarray) -> Truth:
    """The exact mesh of a capture; Mitsuba's variant must be set."""
    from fipt_blender.core.surface.room import Room

    vertices, triangles = read_obj(capture / "scene.obj")
    vertices = conventions.transform_points(world_from_source, vertices)
    none = np.zeros(len(triangles), np.int32)
    with np.load(capture / "scene.npz", allow_pickle=False) as table:
        part, emits = table["part"], table["is_emitter"]
    normals = np.zeros((len(triangles), 3, 3), np.float32)
    room = Room(vertices.astype(np.float32), triangles.astype(np.int32), normals, none, none - 1)
    return Truth(room, part, emits)


def compare(room: Room, truth: Truth, views: Sequence[View], tolerance: float) -> Wrong:
    """What a room shows otherwise than the truth does.

    Args:
        tolerance: metres along the rays.
    """
    from fipt_blender.core.pixels.camera_rays import first_hits, trace_pixels

    counts, parts = np.zeros(3, np.int64), np.zeros(int(truth.part.max()) + 1, np.int64)
    pixels = 0
    for view in views:
        shape = (view.height, view.width)
        triangle, true = (each.reshape(shape) for each in first_hits(trace_pixels(truth.room, view)))
        found = first_hits(trace_pixels(room, view))[1].reshape(shape)
        behind, before = farther(found, true, tolerance), farther(true, found, tolerance)
        border = (behind | before) & near_right(found, true, tolerance)
        counts += [int((behind & ~border).sum()), int((before & ~border).sum()), int(border.sum())]
        pixels += true.size
        unseen = triangle[behind & ~border & (triangle >= 0)]
        parts += np.bincount(truth.part[unseen], minlength=len(parts))
    behind, before, border = (float(count) / max(pixels, 1) for count in counts)
    lost = {int(part): int(parts[part]) for part in np.argsort(-parts) if parts[part]}
    return Wrong(behind, before, border, leaving(room, truth, tolerance), lost)


def farther(one: np.ndarray, other: np.ndarray, tolerance: float) -> np.ndarray:
    """Where one distance is larger by more than the tolerance; infinite ones are equal."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nan_to_num(one - other, nan=0.0, posinf=np.inf) > tolerance)


def near_right(found: np.ndarray, true: np.ndarray, tolerance: float) -> np.ndarray:
    """(H, W) bool, pixels whose distance is right for one of the eight around them."""
    height, width = true.shape
    around = np.pad(true, 1, mode="edge")
    right = np.zeros(true.shape, bool)
    for down in range(3):
        for across in range(3):
            other = around[down : down + height, across : across + width]
            right |= ~farther(found, other, tolerance) & ~farther(other, found, tolerance)
    return right


def leaving(room: Room, truth: Truth, tolerance: float) -> float:
    """Share of the rays of lamps, by area and cosine, that pass the true surface."""
    from fipt_blender.core.pixels.camera_rays import first_hits, rays_along

    rng = np.random.default_rng(0)
    lamps = np.flatnonzero(truth.emits)
    if not len(lamps):
        return 0.0
    areas = truth.room.areas[lamps]
    chosen = rng.choice(lamps, LAMP_RAYS, p=areas / areas.sum())
    places = truth.room.points_on(chosen, *rng.random((2, LAMP_RAYS)))
    normals = truth.room.normals[chosen]
    direction = normals + on_sphere(rng, LAMP_RAYS)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = places + START * normals
    true = first_hits(truth.room.intersect(rays_along(start, direction)))[1]
    # The lamp itself is in the scan, too, with its noise.
    away = true > tolerance
    beyond = start + tolerance * direction
    found = first_hits(room.intersect(rays_along(beyond, direction)))[1] + tolerance
    return float((away & farther(found, true, tolerance)).sum() / max(int(away.sum()), 1))


def on_sphere(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) random unit vectors."""
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def completed(source: RunFolder, settings: Settings, views: Sequence[View]) -> tuple[Room, float]:
    """The room of a run with what photographs complete, and the processor time that it took in seconds."""
    from fipt_blender.core.completion.panes import close_holes
    from fipt_blender.core.surface.room import load_room
    from fipt_blender.core.surface.stored import prepare_geometry

    with tempfile.TemporaryDirectory(dir=source.root.parent) as folder:
        run = RunFolder(Path(folder) / "run")
        run.root.mkdir()
        copy_files(source.root, run.root, ("room.npz", "room.json", "capture.json", *CLEANED_FILES))
        prepare_geometry(run, settings.clean_scan, settings.close_holes_edges)
        began = time.process_time()
        close_holes(run, views, settings)
        return load_room(run, outlined=False), time.process_time() - began


def changes(rows: Sequence[str]) -> dict[str, Settings]:
    """Settings by the name of the row: none, all, or some kinds joined with +."""
    base = Settings()
    found = {}
    for row in rows:
        on = set(KINDS) if row == "all" else set(row.split("+")) & set(KINDS)
        found[row] = make_settings(base.preset, {kind: kind in on for kind in KINDS})
    return found


def main(argv: Sequence[str]) -> int:
    """Run the command; 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("capture", type=Path, help="with ground truth")
    parser.add_argument("run", type=Path, help="prepared run folder")
    parser.add_argument("--voxel", type=float, default=0.02, help="of the scan, metres; half the tolerance")
    parser.add_argument("--view-share", type=float, default=0.5, help="of the training views")
    parser.add_argument("--rows", default="none," + ",".join(KINDS) + ",all")
    arguments = parser.parse_args(list(argv))
    set_variant("llvm")
    from fipt_blender.core.estimate.input import spread_views

    source = RunFolder(arguments.run)
    capture = load_capture(source)
    truth = read_truth(arguments.capture, capture.world_from_source)
    views = light_views(source, spread_views(capture.train, arguments.view_share), Settings().light_pixels)
    every = [*capture.train, *capture.held_back]
    print(
        "| | behind | before | border | light that leaves | seconds | parts |\n|---|---|---|---|---|---|---|"
    )
    for name, settings in changes(arguments.rows.split(",")).items():
        room, seconds = completed(source, settings, views)
        wrong = compare(room, truth, every, 2.0 * arguments.voxel)
        shares = [f"{100.0 * x:.2f} %" for x in (wrong.behind, wrong.before, wrong.border, wrong.leaves)]
        most = ", ".join(f"{part}: {count}" for part, count in list(wrong.parts.items())[:8])
        print(f"| {name} | " + " | ".join(shares) + f" | {seconds:.0f} | {most} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
