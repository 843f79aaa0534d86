# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles of the room a view sees, with few rays: a coarse grid of pixels, and one to the middle of
each triangle that fell between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from .pixels import NO_TRIANGLE, opaque_vector, trace_pixels
from .room import Room

GRID = 256  # pixels along the longer side
_NEAR = 2e-5  # of the distance: faces that lie in one another are both seen


@dataclass(frozen=True)
class Sight:
    """What a view sees.

    Attributes:
        seen: (T,) bool, whether any of each triangle is seen.
        around: (T,) bool, whether it would be seen if the camera looked there: its middle, or more than that.
        room_share: 0..1, share of the pixels that see the mesh.
    """

    seen: np.ndarray
    around: np.ndarray
    room_share: float


def trace_view(room: Room, view: View) -> Sight:
    """Which triangles a view sees, whatever their size."""
    triangle = coarse_triangles(room, coarse_view(view))
    seen = np.zeros(len(room.triangles), bool)
    seen[triangle[triangle >= 0]] = True
    middles, around = _middles_seen(room, view)
    seen |= middles
    return Sight(seen, seen | around, float((triangle >= 0).mean()))


def coarse_view(view: View, grid: int = GRID) -> View:
    """The same camera with at most `grid` pixels along its longer side."""
    factor = min(1.0, grid / max(view.width, view.height))
    width, height = max(1, round(view.width * factor)), max(1, round(view.height * factor))
    x, y = width / view.width, height / view.height
    return replace(
        view, width=width, height=height, fx=view.fx * x, fy=view.fy * y, cx=view.cx * x, cy=view.cy * y
    )


def coarse_triangles(room: Room, view: View) -> np.ndarray:
    """(H * W,) int32 triangle seen by each pixel, NO_TRIANGLE where none."""
    surface = trace_pixels(room, view)
    return np.where(np.array(surface.valid), np.array(surface.triangle).astype(np.int32), NO_TRIANGLE)


def fuse_inputs(
    room: Room, views: Sequence[View], source: str
) -> tuple[list[np.ndarray | None], list[np.ndarray]]:
    """Id images and triangles seen, both on the coarse grid; nothing for sources that are no images."""
    if source not in ("masks", "semantics"):
        return [], []
    images: list[np.ndarray | None] = []
    triangles = []
    for view in views:
        ids = view.part_ids() if source == "masks" else view.semantic_ids()
        if ids is None:
            continue
        small = coarse_view(view)
        rows = ((np.arange(small.height) + 0.5) * view.height / small.height).astype(np.int64)
        columns = ((np.arange(small.width) + 0.5) * view.width / small.width).astype(np.int64)
        images.append(ids[rows[:, None], columns])
        triangles.append(coarse_triangles(room, small))
    return images, triangles


def _middles_seen(room: Room, view: View) -> tuple[np.ndarray, np.ndarray]:
    """(T,) bool each: whether the middle of each triangle lies in the image with nothing before it, and
    whether nothing lies before it, in the image or not.
    """
    corners = [mi.Int32(np.ascontiguousarray(room.triangles[:, axis], np.int32)) for axis in range(3)]
    table = mi.Float(np.ascontiguousarray(room.vertices, np.float32).reshape(-1))
    middle = sum(dr.gather(mi.Point3f, table, corner) for corner in corners) / 3.0
    pose = np.asarray(view.camera_to_world, np.float64)
    origin = opaque_vector(mi.Point3f, pose[:3, 3])
    away = mi.Vector3f(middle - origin)
    x, y, z = (dr.dot(away, opaque_vector(mi.Vector3f, pose[:3, axis])) for axis in range(3))
    numbers = (view.fx, view.fy, view.cx, view.cy, view.width, view.height)
    fx, fy, cx, cy, width, height = (dr.opaque(mi.Float, float(number)) for number in numbers)
    column, row = fx * x / z + cx, fy * y / z + cy
    inside = (z > 0.0) & (column >= 0.0) & (column <= width) & (row >= 0.0) & (row <= height)
    distance = dr.norm(away)
    ray = mi.Ray3f(origin, away / dr.maximum(distance, 1e-20))
    hit = room.scene.ray_intersect_preliminary(ray, coherent=False)
    same = hit.prim_index == dr.arange(mi.UInt32, len(room.triangles))
    free = hit.is_valid() & (same | (hit.t > distance * (1.0 - _NEAR)))
    return np.array(inside & free), np.array(free)
