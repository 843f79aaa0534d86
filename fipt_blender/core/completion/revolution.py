# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Upright surfaces of revolution, fitted to triangles of a scan: lamp shades, vases, pots, drums, columns."""

from __future__ import annotations

import numpy as np

from .cells import CellSurface

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


def revolved(axis: np.ndarray, low: float, step: float, radius: np.ndarray, side: int) -> CellSurface:
    """The surface of revolution about an upright axis.

    Args:
        axis: (2,) x and y of the axis, metres.
        low: z of the lower end, metres.
        step: height of a row, metres.
        radius: (R + 1,) metres at the ends of the rows, upwards.
        side: 1 where its front is outside, -1 where it is inside.
    """
    count = max(int(np.ceil(2.0 * np.pi * float(radius.max()) / step)), 3)
    angle = -side * 2.0 * np.pi * np.arange(count + 1) / count
    away = np.stack([np.cos(angle), np.sin(angle), np.zeros(count + 1)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    height, slope = low + step * np.arange(len(radius)), np.gradient(radius) / step
    places = np.append(axis, 0.0) + radius[:, None, None] * away + height[:, None, None] * up
    normals = side * (away - slope[:, None, None] * up) / np.sqrt(1.0 + slope**2)[:, None, None]
    return CellSurface(places, normals, step, around=True)


def fit_revolutions(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, step: float
) -> list[CellSurface]:
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
) -> CellSurface | None:
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
    return revolved(axis, float(low), (high - low) / rows, np.maximum(ends, 0.0), side)
