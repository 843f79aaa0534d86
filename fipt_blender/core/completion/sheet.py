# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets: nearly plane surfaces as heights over a plane, such as fronts of cabinets, boards and curtains.

They are fitted to the triangles of a scan, and meshed where the scan has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from ..surface.adjacency import without_unused

# Triangles within so many cells of a plane, which face its front by at least this cosine, are of its sheet.
BAND, LEAST_FACING = 2.0, 0.5
# Planes that are tried, and triangles that each is tried on.
CANDIDATES, _SAMPLE = 100, 5000
# The plane goes on by this share of its extent, as torn ends have to be found; masks show where it ends.
MARGIN = 0.5
# Where the scan has nothing, heights are means of those around, by a Gaussian of so many cells.
SMOOTHED = 3.0
_MOST_CELLS = 500


@dataclass(frozen=True)
class Sheet:
    """Heights over a rectangle of a plane, in square cells.

    Attributes:
        corner: (3,) place of the corner of cell (0, 0) on the plane, metres.
        axes: (3, 3) unit vectors along the rows' numbers, along the columns', and of the front.
        step: edge of a cell, metres.
        height: (R + 1, S + 1) metres of the cells' corners over the plane.
    """

    corner: np.ndarray
    axes: np.ndarray
    step: float
    height: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.height.shape[0] - 1, self.height.shape[1] - 1

    def near(self, points: np.ndarray, distance: float) -> np.ndarray:
        """(N,) bool, whether points (N, 3) are so many metres from the plane or closer."""
        return np.asarray(np.abs((points - self.corner) @ self.axes[2]) < distance)

    def cells(self, down: float = 0.0, across: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Places (R, S, 3) in the cells and unit normals (R, S, 3) of their fronts.

        Args:
            down, across: where, in cells from their middles.
        """
        rows, columns = self.shape
        v, u = 0.5 + down, 0.5 + across
        low, high = self.height[:-1], self.height[1:]
        height = (1 - v) * ((1 - u) * low[:, :-1] + u * low[:, 1:]) + v * (
            (1 - u) * high[:, :-1] + u * high[:, 1:]
        )
        places = self._places(np.arange(rows) + v, np.arange(columns) + u, height)
        normals = self._normals()
        mean = normals[:-1, :-1] + normals[1:, :-1] + normals[:-1, 1:] + normals[1:, 1:]
        return places, mean / np.linalg.norm(mean, axis=2, keepdims=True)

    def surface(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mesh of some cells (R, S) bool.

        Returns:
            vertices (V, 3) float32, triangles (T, 3) int32, and corner normals (T, 3, 3) float32.
        """
        rows, columns = self.height.shape
        row, column = np.nonzero(chosen)
        corners = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)]
        index = np.stack([down * columns + across for down, across in corners], axis=1)
        used, triangles = without_unused(index[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
        places = self._places(np.arange(float(rows)), np.arange(float(columns)), self.height)
        normals = self._normals().reshape(-1, 3)[used][triangles]
        return places.reshape(-1, 3)[used].astype(np.float32), triangles, normals.astype(np.float32)

    def _places(self, row: np.ndarray, column: np.ndarray, height: np.ndarray) -> np.ndarray:
        flat = self.corner + self.step * (
            row[:, None, None] * self.axes[0] + column[None, :, None] * self.axes[1]
        )
        return np.asarray(flat + height[:, :, None] * self.axes[2])

    def _normals(self) -> np.ndarray:
        """(R + 1, S + 1, 3) unit normals at the cells' corners."""
        down, across = np.gradient(self.height, self.step)
        normals = self.axes[2] - down[:, :, None] * self.axes[0] - across[:, :, None] * self.axes[1]
        return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))


def fit_sheets(
    points: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    step: float,
    least: int,
    rng: np.random.Generator,
) -> list[Sheet]:
    """Sheets through the triangles of a part, the largest first; each triangle is of one at most.

    Args:
        points: (N, 3) middles of the triangles, metres.
        normals: (N, 3) unit normals of their fronts.
        areas: (N,) square metres.
        step: edge of a cell, metres.
        least: triangles of a sheet.
    """
    found = []
    left = np.arange(len(points))
    while len(left) >= least:
        rows = _largest_plane(points[left], normals[left], areas[left], BAND * step, rng)
        if len(rows) < least:
            break
        rows = left[rows]
        sheet = _fitted(points[rows], normals[rows], areas[rows], step)
        if sheet is not None:
            found.append(sheet)
        left = np.setdiff1d(left, rows)
    return found


def _largest_plane(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, band: float, rng: np.random.Generator
) -> np.ndarray:
    """Rows of the triangles on the plane with the largest area, of those through some triangles (RANSAC)."""
    share = areas / areas.sum()
    tried = rng.choice(len(points), min(CANDIDATES, len(points)), replace=False, p=share)
    sample = rng.choice(len(points), min(_SAMPLE, len(points)), replace=False)

    def on(plane: int, rows: np.ndarray) -> np.ndarray:
        off = np.abs((points[rows] - points[plane]) @ normals[plane]) < band
        return np.asarray(off & (normals[rows] @ normals[plane] > LEAST_FACING))

    best = max(tried, key=lambda plane: float(areas[sample][on(plane, sample)].sum()))
    return np.flatnonzero(on(best, np.arange(len(points))))


def _fitted(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float) -> Sheet | None:
    """The sheet of the triangles on a plane, None if it is too large."""
    centre = np.average(points, axis=0, weights=areas)
    axes = np.linalg.svd((points - centre) * np.sqrt(areas)[:, None], full_matrices=False)[2]
    if (normals @ axes[2] * areas).sum() < 0.0:
        axes[2] = -axes[2]
    axes[1] = np.cross(axes[2], axes[0])
    local = (points - centre) @ axes.T
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
    rows, columns = np.ceil((high - low) / step).astype(int)
    if max(rows, columns) > _MOST_CELLS:
        return None
    # Each triangle counts for the nearest corner of a cell.
    row, column = np.round((local[:, :2] - low) / step).astype(np.int64).T
    weight, total = np.zeros((2, rows + 1, columns + 1))
    np.add.at(weight, (row, column), areas)
    np.add.at(total, (row, column), areas * local[:, 2])
    around = gaussian_filter(np.stack([weight, total]), (0.0, SMOOTHED, SMOOTHED), mode="constant")
    little = 1e-3 * float(areas.mean())  # far from all triangles the height goes to that of the plane
    height = np.where(weight > 0.0, total / np.maximum(weight, 1e-20), around[1] / (around[0] + little))
    return Sheet(centre + low @ axes[:2], axes, step, height)
