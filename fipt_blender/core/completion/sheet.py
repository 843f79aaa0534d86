# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets: heights over a plane, fitted to triangles of a scan, such as fronts, boards and curtains."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from .cells import CellSurface

# Triangles within so many cells of a plane, which face its front by at least this cosine, are of its sheet.
BAND, LEAST_FACING = 2.0, 0.5
# Planes that are tried, and triangles that each is tried on.
CANDIDATES, _SAMPLE = 100, 5000
# The plane goes on by this share of its extent, as torn ends have to be found; masks show where it ends.
MARGIN = 0.5
# Where the scan has nothing, heights are means of those around, by a Gaussian of so many cells.
SMOOTHED = 3.0
_MOST_CELLS = 500


def fit_sheets(
    points: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    step: float,
    least: int,
    rng: np.random.Generator,
) -> list[CellSurface]:
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


def _fitted(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float) -> CellSurface | None:
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
    flat = np.moveaxis(low[:, None, None] + step * np.indices(height.shape), 0, 2)
    down, across = np.gradient(height, step)
    along = np.dstack([-down, -across, np.ones_like(height)]) @ axes
    normals = along / np.linalg.norm(along, axis=2, keepdims=True)
    return CellSurface(centre + np.dstack([flat, height]) @ axes, normals, step)
