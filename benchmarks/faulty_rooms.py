# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A small room with faults that are built into its capture, for benchmarks/judged_faults.py.

Mitsuba's variant must be set before this is imported.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from benchmarks.disturb import disturb
from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.report.pictures import write_png
from fipt_blender.core.run.runfolder import RunFolder
from samples.small_captures import (
    PANEL,
    PANEL_RADIANCE,
    SmallCapture,
    matt,
    photograph_room,
    run_here,
    write_run,
)
from samples.small_rooms import BOX, make_room, mesh_room, table

PATCHES = 9  # of a wall along each side
HELD_BACK = (3, 7, 11)
SETTINGS = {"voxel_resolution": 96, "training_steps": 150, "hash_levels": 8, "hash_log2_size": 14}


@dataclass(frozen=True, eq=False)
class Case:
    """A capture before it is estimated: photographs, poses, a factor of the focal length, and the mesh."""

    capture: SmallCapture
    focal: float = 1.0
    encoded: bool = False


def divided(quad: Sequence[Sequence[float]], count: int) -> list[np.ndarray]:
    """A quadrilateral as count x count smaller ones."""
    a, b, c, d = (np.array(corner, float) for corner in quad)
    share = np.linspace(0.0, 1.0, count + 1)

    def at(u: float, v: float) -> np.ndarray:
        return a * (1 - u) * (1 - v) + b * u * (1 - v) + c * u * v + d * (1 - u) * v

    pairs = [(i, j) for i in range(count) for j in range(count)]
    return [
        np.array(
            [
                at(share[i], share[j]),
                at(share[i + 1], share[j]),
                at(share[i + 1], share[j + 1]),
                at(share[i], share[j + 1]),
            ]
        )
        for i, j in pairs
    ]


def block(low: Sequence[float], high: Sequence[float]) -> list[np.ndarray]:
    """Five sides of a box that stands on the floor, fronts outwards."""
    size = np.subtract(high, low)
    unit = (np.array(BOX) + [2.0, 2.0, 0.0]) / [4.0, 4.0, 3.0]
    return [(quad * size + low)[::-1] for index, quad in enumerate(unit) if index]


def room_capture(seed: int = 0) -> tuple[SmallCapture, int]:
    """The true capture, and the number of quadrilaterals of the walls."""
    rng = np.random.default_rng(seed)
    walls = [patch for quad in BOX for patch in divided(quad, PATCHES)]
    things = [*block((-0.4, 0.3, 0.0), (0.9, 1.2, 0.75)), *block((0.8, -1.3, 0.0), (1.4, -0.7, 0.6))]
    things = [patch for quad in things for patch in divided(quad, 3)]
    quads = [*walls, *things, np.array(PANEL)]
    colors = rng.uniform(0.25, 0.8, (6, 3)).repeat(PATCHES**2, axis=0) * rng.uniform(
        0.45, 1.2, (len(walls), 1)
    )
    colors = np.concatenate([colors, rng.uniform(0.15, 0.7, (len(things), 3)), np.zeros((1, 3))])
    room = make_room(quads, parts="objects")
    last = 2 * len(quads) - 2
    cameras = []
    for turn in np.linspace(0.0, 2.0 * np.pi, 14, endpoint=False):
        place = 1.5 * np.cos(turn), 1.5 * np.sin(turn), 1.3 + 0.3 * np.sin(3.0 * turn)
        up = 2.2 if len(cameras) in (2, 6, 10) else 0.5  # only these three show the lamp
        cameras.append([list(place), [-1.2 * np.cos(turn + 0.3), -1.2 * np.sin(turn + 0.3), up]])
    lamp = table([last, last + 1], list(PANEL_RADIANCE))
    return photograph_room(
        room, matt(np.repeat(colors, 2, axis=0)), lamp, cameras=cameras, scale=2, denoise=True
    ), len(walls)


def kept(capture: SmallCapture, keep: np.ndarray) -> SmallCapture:
    """The capture with some triangles (T,) bool of its mesh."""
    room = capture.room
    return replace(
        capture,
        room=mesh_room(room.vertices, room.triangles[keep], room.triangle_object[keep], parts="objects"),
    )


def turned(capture: SmallCapture, degrees: float, share: float) -> SmallCapture:
    """Some poses turned about random axes."""
    rng = np.random.default_rng(1)
    poses = [pose.copy() for pose in capture.poses]
    for index in rng.permutation(len(poses))[: round(share * len(poses))]:
        axis = rng.normal(size=3)
        poses[index][:3, :3] = poses[index][:3, :3] @ turn_by(
            np.radians(degrees) * axis / np.linalg.norm(axis)
        )
    return replace(capture, poses=poses)


def changed(capture: SmallCapture, change: Callable[[int, np.ndarray], np.ndarray]) -> SmallCapture:
    """The capture with other photographs."""
    return replace(
        capture, images=[change(i, image).astype(np.float32) for i, image in enumerate(capture.images)]
    )


def moved_mesh(
    capture: SmallCapture, vertices: np.ndarray, triangles: np.ndarray | None = None
) -> SmallCapture:
    room = capture.room
    if triangles is None:
        return replace(
            capture, room=mesh_room(vertices, room.triangles, room.triangle_object, parts="objects")
        )
    return replace(capture, room=mesh_room(vertices, triangles, np.zeros(len(triangles)), parts="loose"))


def without_views(capture: SmallCapture, left_out: Sequence[int]) -> SmallCapture:
    """The capture with black, masked photographs of some views: they are repeated from their neighbours."""
    images, poses = list(capture.images), list(capture.poses)
    for index in left_out:
        images[index], poses[index] = images[index - 2], poses[index - 2]
    return replace(capture, images=images, poses=poses)


def faults(capture: SmallCapture, walls: int) -> dict[str, tuple[Case, set[str]]]:
    """The cases, and the causes or codes that are right."""
    centre = capture.room.vertices[capture.room.triangles].mean(axis=1)
    count, rng = len(capture.room.triangles), np.random.default_rng(2)
    wall = (centre[:, 0] > 1.99) & (np.abs(centre[:, 1]) < 1.4) & (centre[:, 2] < 2.2)
    thing = np.arange(count) >= 2 * walls
    crate = thing & (centre[:, 1] < 0.0) & (centre[:, 2] < 2.0)
    lamp = np.arange(count) >= count - 2
    floor = (centre[:, 2] < 0.01) & (np.abs(centre[:, 0]) < 1.2)
    middle = np.median(np.concatenate([image.ravel() for image in capture.images]))
    gains = rng.uniform(0.75, 1.3, (len(capture.images), 3))
    rough = disturb(capture.room.vertices.astype(float), capture.room.triangles.astype(np.int64), 0.06, 0)
    surfaces, poses, photographs = (
        {"surfaces"},
        {"poses", "views-disagree", "mesh-elsewhere"},
        {"photographs"},
    )
    return {
        "none": (Case(capture), set()),
        "hole in a wall": (Case(kept(capture, ~wall)), surfaces),
        "hole in the floor": (Case(kept(capture, ~floor)), surfaces),
        "crate missing": (Case(kept(capture, ~crate)), surfaces),
        "rough mesh": (Case(moved_mesh(capture, *rough)), surfaces),
        "lamp missing": (
            Case(kept(without_views(capture, (2, 6, 10)), ~lamp)),
            {"light that nothing shows", "lamps"},
        ),
        "poses": (Case(turned(capture, 2.5, 0.5)), poses),
        "calibration": (Case(capture, focal=1.06), poses),
        "clipped": (
            Case(
                changed(capture, lambda i, image: np.minimum(image * 2.5 / middle * 0.18, 1.0)), encoded=True
            ),
            photographs,
        ),
        "balance": (Case(changed(capture, lambda i, image: image * gains[i])), photographs),
        "blur": (
            Case(
                changed(capture, lambda i, image: gaussian_filter(image, (2.0, 2.0, 0.0)) if i % 2 else image)
            ),
            photographs,
        ),
        "scale": (Case(moved_mesh(capture, capture.room.vertices * 1.12)), poses | surfaces),
    }


def estimated(case: Case, root: Path) -> RunFolder:
    """The run of a case.

    Raises:
        FiptError: where it is refused.
    """
    run = write_run(root, case.capture, **SETTINGS)
    data = json.loads(run.capture_json.read_text())
    for index, view in enumerate(data["views"]):
        view["fx"], view["fy"] = view["fx"] * case.focal, view["fy"] * case.focal
        if index in HELD_BACK:
            view["split"] = "held_back"
        if case.encoded:
            path = run.images / f"{index:03d}.png"
            write_png(path, srgb_encoded(case.capture.images[index]))
            view["image"], view["encoded"] = f"images/{path.name}", True
    run.capture_json.write_text(json.dumps(data))
    run_here(run)
    return run
