# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The polygons of a mesh file, their check and their triangles.

For the engine and for the check before Blender's importers. Needs numpy alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.shapes import FARTHEST_UNITS

MOST_CORNERS = 5000  # of a concave polygon: cutting its ears takes up to the cube of that many steps


@dataclass(frozen=True, eq=False)
class Polygons:
    """A mesh as its file has it.

    Attributes:
        vertices: (V, 3) float64, in the file's coordinates.
        corners: (C,) int64 vertex indices of all polygons, one polygon after the other.
        lengths: (F,) int64 number of corners of each polygon.
    """

    vertices: np.ndarray
    corners: np.ndarray
    lengths: np.ndarray

    def check(self, first: int = 0) -> None:
        """Check coordinates and indices.

        Args:
            first: number of the first vertex in the file, for the message.

        Raises:
            ValueError: what is wrong.
        """
        count = len(self.vertices)
        wrong = count - int((np.abs(self.vertices) <= FARTHEST_UNITS).all(axis=1).sum())
        if wrong:
            raise ValueError(f"{wrong:,} of {count:,} vertices are no numbers, or impossibly far away")
        if not self.lengths.all():
            raise ValueError("a face has no vertices")
        check_indices(self.corners, count, first)

    def triangles(self) -> np.ndarray:
        """(T, 3) int64 triangles of the polygons, with their winding; concave ones are cut at their ears.

        Raises:
            ValueError: a concave polygon has too many corners.
        """
        starts = np.cumsum(self.lengths) - self.lengths
        found = [np.zeros((0, 3), np.int64)]
        for length in np.unique(self.lengths[self.lengths >= 3]):
            polygons = self.corners[starts[self.lengths == length, None] + np.arange(length)]
            # A fan from the first corner, and where that leaves the polygon from the second one: all
            # triangles and quadrilaterals, and most other polygons.
            for _ in range(min(int(length) - 2, 2)):
                fans = np.stack(
                    np.broadcast_arrays(polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]), axis=2
                )
                inside = _are_inside(self.vertices, polygons)
                found.append(fans[inside].reshape(-1, 3))
                polygons = np.roll(polygons[~inside], -1, axis=1)
            found += [_cut_ears(self.vertices, polygon) for polygon in polygons]
        return np.concatenate(found)


def check_indices(indices: np.ndarray, count: int, first: int = 0) -> None:
    """Raise a ValueError where an index is not one of `count` vertices."""
    for index in (int(indices.min(initial=0)), int(indices.max(initial=0))):
        if index and not 0 <= index < count:
            raise ValueError(f"a face or edge names the vertex {index + first}, and there are {count:,}")


def _are_inside(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """(F,) bool: whether the fan from the first corner lies in its polygon, for polygons (F, n)."""
    if polygons.shape[1] == 3:
        return np.ones(len(polygons), bool)
    sides = vertices[polygons[:, 1:]] - vertices[polygons[:, :1]]
    crosses = np.cross(sides[:, :-1], sides[:, 1:])
    return ((crosses * crosses.sum(axis=1, keepdims=True)).sum(axis=2) >= 0.0).all(axis=1)


def _cut_ears(vertices: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Triangles (n - 2, 3) of a concave polygon (n,): corners whose triangle holds no other are cut off."""
    if len(polygon) > MOST_CORNERS:
        raise ValueError(f"a concave face has {len(polygon):,} corners; triangulate it")
    points = vertices[polygon] - vertices[polygon[0]]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    # Seen along the axis nearest to the normal, counterclockwise.
    flat = np.delete(points, drop, axis=1) * [1.0, np.sign(normal[drop]) * (-1.0 if drop == 1 else 1.0)]
    ring, found = list(range(len(polygon))), []
    while len(ring) > 3:
        for place in range(1, len(ring) + 1):
            ear = [ring[place - 1], ring[place % len(ring)], ring[(place + 1) % len(ring)]]
            if _is_ear(flat[ear], flat[ring]):
                break
        found.append(ear)  # where none is, as in polygons that cross themselves, any one
        del ring[place % len(ring)]
    return polygon[np.array([*found, ring])]


def _is_ear(corners: np.ndarray, others: np.ndarray) -> bool:
    """Whether a triangle (3, 2) turns left and holds none of the points (N, 2) but its corners."""
    sides = np.roll(corners, -1, axis=0) - corners
    offsets = others[:, None] - corners
    left = sides[:, 0] * offsets[:, :, 1] - sides[:, 1] * offsets[:, :, 0]
    area = sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]
    inside = (left >= 0.0).all(axis=1) & (offsets != 0.0).any(axis=2).all(axis=1)
    return bool(area > 0.0 and not inside.any())
