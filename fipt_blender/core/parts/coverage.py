# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles of the room a view sees, from few rays: one through each pixel of a coarse image, and one
to the centroid of each triangle, because small triangles fall between the pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..pixels.camera_rays import first_hits, opaque_vector, trace_pixels
from ..surface.room import Room
from .labels import IMAGE_SOURCES

GRID = 256  # pixels along the longer side
_COINCIDENT = 2e-5  # of the distance: coincident faces do not occlude each other


@dataclass(frozen=True)
class Coverage:
    """The triangles that a view sees.

    Attributes:
        seen: (T,) bool, whether some point of each triangle is seen.
        in_sight: (T,) bool, whether it is seen or, if it was not `known`, its centroid would be visible to
            the camera after a rotation towards it.
        room_share: 0..1, share of the pixels that see the mesh.
    """

    seen: np.ndarray
    in_sight: np.ndarray
    room_share: float


def view_coverage(room: Room, view: View, known: np.ndarray) -> Coverage:
    """Which triangles a view sees, whatever their size.

    Args:
        known: (T,) bool, triangles that are in sight of earlier views. Outside the image they are not tested
            again, which saves rays.
    """
    triangle = coarse_triangles(room, coarse_view(view))
    seen = np.zeros(len(room.triangles), bool)
    seen[triangle[triangle >= 0]] = True
    centroid_seen, centroid_in_sight = _centroids_seen(room, view, known)
    seen |= centroid_seen
    return Coverage(seen, seen | centroid_in_sight, float((triangle >= 0).mean()))


def coarse_view(view: View) -> View:
    """The same camera with at most `GRID` pixels along its longer side."""
    factor = min(1.0, GRID / max(view.width, view.height))
    return view.resized(max(1, round(view.width * factor)), max(1, round(view.height * factor)))


def resampled(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) values of an image (H, W), read at the centres of the pixels of an image of another size."""
    rows, columns = (
        ((np.arange(count) + 0.5) * of / count).astype(np.int64)
        for count, of in zip(shape, image.shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def coarse_triangles(room: Room, view: View) -> np.ndarray:
    """(H * W,) int32 triangle that each pixel sees, -1 where none."""
    return first_hits(trace_pixels(room, view))[0].astype(np.int32)


def fuse_inputs(
    room: Room, views: Sequence[View], source: str
) -> tuple[list[np.ndarray | None], list[np.ndarray]]:
    """Inputs of `label_parts` on the coarse pixel grid; empty for sources other than id images.

    Returns:
        for each view that has an id image of the source, the (H, W) ids and the (H * W,) triangles seen.

    Raises:
        FiptError: those of reading the id images.
    """
    if source not in IMAGE_SOURCES:
        return [], []
    images: list[np.ndarray | None] = []
    triangles = []
    for view in views:
        ids = view.part_ids() if source == "masks" else view.semantic_ids()
        if ids is None:
            continue
        coarse = coarse_view(view)
        images.append(resampled(ids, (coarse.height, coarse.width)))
        triangles.append(coarse_triangles(room, coarse))
    return images, triangles


def _centroids_seen(room: Room, view: View, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (T,) bool: whether each triangle's centroid is in the image and not occluded; and whether it is not
    occluded, also outside the image. Outside, only triangles that are not `known` are tested.
    """
    corners = [mi.Int32(np.ascontiguousarray(room.triangles[:, axis], np.int32)) for axis in range(3)]
    table = mi.Float(np.ascontiguousarray(room.vertices, np.float32).reshape(-1))
    centroid = sum(dr.gather(mi.Point3f, table, corner) for corner in corners) / 3.0
    pose = np.asarray(view.camera_to_world, np.float64)
    origin = opaque_vector(mi.Point3f, pose[:3, 3])
    toward = mi.Vector3f(centroid - origin)
    x, y, z = (dr.dot(toward, opaque_vector(mi.Vector3f, pose[:3, axis])) for axis in range(3))
    parameters = (view.fx, view.fy, view.cx, view.cy, view.width, view.height)
    fx, fy, cx, cy, width, height = (dr.opaque(mi.Float, float(value)) for value in parameters)
    column, row = fx * x / z + cx, fy * y / z + cy
    inside = (z > 0.0) & (column >= 0.0) & (column <= width) & (row >= 0.0) & (row <= height)
    traced = inside | ~mi.Bool(np.ascontiguousarray(known))
    dr.eval(inside, traced, toward)
    index = dr.compress(traced)
    if not dr.width(index):
        return np.zeros(len(known), bool), np.zeros(len(known), bool)
    toward = dr.gather(mi.Vector3f, toward, index)
    distance = dr.norm(toward)
    ray = mi.Ray3f(origin, toward / dr.maximum(distance, 1e-20))
    hit = room.scene.ray_intersect_preliminary(ray, coherent=False)
    reached = hit.prim_index == index
    unhidden = dr.zeros(mi.Bool, len(room.triangles))
    dr.scatter(unhidden, hit.is_valid() & (reached | (hit.t > distance * (1.0 - _COINCIDENT))), index)
    return np.array(inside & unhidden), np.array(unhidden)
