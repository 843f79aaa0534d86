# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Upright surfaces of revolution: lamp shades, vases, pots, drums, columns.

They are fitted to the triangles of a scan, and meshed where the scan has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..surface.adjacency import without_unused

# Triangles that face up or down by more than this sine hardly determine an axis or a radius.
STEEPEST = 0.87
# Share of the area that must lie within half a row of the surface, and most degrees between the normals
# and the surface's (median): boxes, leaves and cushions do not reach them, fluted and noisy vases do.
LEAST_INSIDE, MOST_DEGREES = 0.7, 15.0
# In rows: the smallest radius, and the least height.
LEAST_RADIUS, LEAST_ROWS = 3.0, 3
# Share of the area at either end that does not count for its height.
_TAIL = 0.01
_ROUNDS = 15


@dataclass(frozen=True)
class Revolution:
    """A surface of revolution about an upright axis, in rows of cells.

    Attributes:
        axis: (2,) x and y of the axis, metres.
        low: z of the lower end, metres.
        step: height of a row, metres.
        radius: (R + 1,) metres at the ends of the rows, upwards.
        side: 1 where its front is outside, -1 where it is inside.
    """

    axis: np.ndarray
    low: float
    step: float
    radius: np.ndarray
    side: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, and cells in a row, which are about as wide as high."""
        around = 2.0 * np.pi * float(self.radius.max()) / self.step
        return len(self.radius) - 1, max(int(np.ceil(around)), 3)

    def near(self, points: np.ndarray, distance: float) -> np.ndarray:
        """(N,) bool, whether points (N, 3) are so many metres from the surface or closer."""
        row = (points[:, 2] - self.low) / self.step
        off = np.linalg.norm(points[:, :2] - self.axis, axis=1) - self._radii(row)[0]
        inside = (row > -distance / self.step) & (row < len(self.radius) - 1 + distance / self.step)
        return np.asarray(inside & (np.abs(off) < distance))

    def cells(self, down: float = 0.0, across: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Places (R, S, 3) in the cells and unit normals (R, S, 3) of their fronts there.

        Args:
            down, across: where, in cells from their middles.
        """
        rows, count = self.shape
        at = np.arange(rows) + 0.5 + down, np.arange(count) + 0.5 + across
        return self._places(*at), self._normals(*at)

    def surface(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mesh of some cells (R, S) bool.

        Returns:
            vertices (V, 3) float32, triangles (T, 3) int32, and corner normals (T, 3, 3) float32.
        """
        rows, count = self.shape
        row, column = np.nonzero(chosen)
        corners = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
        index = np.stack([down * count + across % count for down, across in corners], axis=1)
        triangles = index[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)[:, :: self.side]
        used, triangles = without_unused(triangles)
        ends = np.arange(rows + 1.0), np.arange(float(count))
        places, normals = self._places(*ends).reshape(-1, 3), self._normals(*ends).reshape(-1, 3)
        return places[used].astype(np.float32), triangles, normals[used][triangles].astype(np.float32)

    def _radii(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radius at heights in rows, and its slope."""
        slope = np.gradient(self.radius) / self.step
        places = np.arange(len(self.radius))
        return np.interp(row, places, self.radius), np.interp(row, places, slope)

    def _around(self, column: np.ndarray) -> np.ndarray:
        """(S, 2) unit vectors from the axis."""
        angle = 2.0 * np.pi * column / self.shape[1]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def _places(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        around = self.axis + self._radii(row)[0][:, None, None] * self._around(column)
        height = np.broadcast_to((self.low + self.step * row)[:, None, None], (*around.shape[:2], 1))
        return np.concatenate([around, height], axis=2)

    def _normals(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        slope = self._radii(row)[1][:, None, None]
        around = np.broadcast_to(self._around(column), (len(row), len(column), 2))
        normals = np.concatenate([around, np.broadcast_to(-slope, (*around.shape[:2], 1))], axis=2)
        return self.side * normals / np.sqrt(1.0 + slope**2)


def fit_revolutions(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> list[Revolution]:
    """Surfaces of revolution through the triangles of one thing, whose outside and inside are apart.

    Args:
        points: (N, 3) middles of the triangles, metres.
        normals: (N, 3) unit normals of their fronts.
        areas: (N,) square metres.
        step: height of a row, metres.

    Returns:
        those that most of the area of a side lies on.
    """
    steep = np.flatnonzero(np.abs(normals[:, 2]) < STEEPEST)
    axis = _axis_of_normals(points[steep], normals[steep], areas[steep], step)
    if axis is None:
        return []
    outward = (normals[steep, :2] * (points[steep, :2] - axis)).sum(axis=1)
    found = []
    for side in (1, -1):
        rows = steep[side * outward > 0.0]
        revolution = _fitted(points[rows], normals[rows], areas[rows], axis, step, side)
        if revolution is not None:
            found.append(revolution)
    return found


def _axis_of_normals(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> np.ndarray | None:
    """(2,) the place that the lines along the normals pass most closely, seen from above; robust."""
    across = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = (across * points[:, :2]).sum(axis=1)
    weight, axis = areas, None
    for _ in range(_ROUNDS):
        matrix = (across * weight[:, None]).T @ across
        if len(points) < 3 or np.linalg.cond(matrix) > 1e6:
            return None
        axis = np.linalg.solve(matrix, across.T @ (weight * along))
        weight = areas / (1.0 + ((along - across @ axis) / (0.5 * step)) ** 2)
    return axis


def _fitted(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, axis: np.ndarray, step: float, side: int
) -> Revolution | None:
    """The surface whose front triangles are given, None where they lie on none."""
    if len(points) < LEAST_ROWS * LEAST_RADIUS:
        return None
    order = np.argsort(points[:, 2])
    share = np.cumsum(areas[order]) / areas.sum()
    low, high = np.interp((_TAIL, 1.0 - _TAIL), share, points[order, 2])
    rows = int(np.ceil((high - low) / step))
    if rows < LEAST_ROWS:
        return None
    row = np.clip(((points[:, 2] - low) / step).astype(np.int64), 0, rows - 1)
    order = np.argsort(row, kind="stable")
    groups = np.split(order, np.searchsorted(row[order], np.arange(1, rows)))
    filled = np.array([len(group) > 0 for group in groups])
    for _ in range(_ROUNDS):
        offset = points[:, :2] - axis
        distance = np.linalg.norm(offset, axis=1)
        medians = np.array([np.median(distance[group]) for group in groups if len(group)])
        profile = np.interp(np.arange(rows), np.flatnonzero(filled), medians)
        off = distance - profile[row]
        weight = areas / (1.0 + (off / (0.5 * step)) ** 2)
        away = offset / np.maximum(distance, 1e-9)[:, None]
        matrix = (away * weight[:, None]).T @ away
        if np.linalg.cond(matrix) > 1e6:
            return None
        axis = axis + np.linalg.solve(matrix, away.T @ (weight * off))
    offset = points[:, :2] - axis
    distance = np.linalg.norm(offset, axis=1)
    inside = areas[np.abs(distance - profile[row]) < 0.5 * step].sum() / areas.sum()
    flat = np.linalg.norm(normals[:, :2], axis=1) * np.maximum(distance, 1e-9)
    cosine = np.abs((normals[:, :2] * offset).sum(axis=1)) / np.maximum(flat, 1e-9)
    turn = np.degrees(np.median(np.arccos(np.clip(cosine, 0.0, 1.0))))
    if inside < LEAST_INSIDE or turn > MOST_DEGREES or profile.max() < LEAST_RADIUS * step:
        return None
    # Rows know the radius at their middles.
    ends = np.interp(np.arange(rows + 1.0), np.arange(rows) + 0.5, profile)
    ends[[0, -1]] += 0.5 * np.array([profile[0] - profile[1], profile[-1] - profile[-2]])
    return Revolution(axis, float(low), (high - low) / rows, np.maximum(ends, 0.0), side)
