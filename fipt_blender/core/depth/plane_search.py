# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes in the sparse points of a room: its level, its main directions, floor, ceiling and walls.

Sparse points have no usable normals. Planes show as many points at one distance along a direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..alignment.turns import rotation_between
from .floor_plan import Line

LEAST_POINTS = 100  # of a solve, for a room
_TILTS = ((20.0, 4.0), (4.0, 1.0), (1.0, 0.25))  # degrees: reach and step of the search for the level
_LEVEL_SHARE = 0.015  # of the points, at least, that lie on a floor or ceiling
_BEYOND = 0.05  # of the points, at most, are below the floor: mirrored and wrong ones
_WALL_SHARE = 0.02  # of the points between floor and ceiling, at least, that lie on a wall
_WALL_POINTS = 12  # at least, that lie on a wall
_FREE = 0.7  # a wall that is not at right angles to the others needs so many more points: over this


@dataclass(frozen=True)
class Level:
    """Height of the floor or the ceiling, and whether points support it."""

    at: float
    found: bool


def crowding(values: np.ndarray, width: float) -> np.ndarray:
    """For each of the sorted values (N,), how many lie within a width of it."""
    return np.asarray(
        np.searchsorted(values, values + width, "right") - np.searchsorted(values, values - width, "left")
    )


def level_axes(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) to coordinates with Z up and X, Y along most walls.

    Args:
        points: (N, 3).
        up: (3,) approximate up direction.
    """
    some = points[:: max(len(points) // 3000, 1)]
    low, high = np.percentile(some, [1.0, 99.0], axis=0)
    width = 0.005 * float(np.linalg.norm(high - low))

    def crowd(directions: np.ndarray) -> np.ndarray:
        return np.array([crowding(np.sort(some @ axis), width).mean() for axis in directions])

    axes = rotation_between(np.asarray(up, np.float64), np.array([0.0, 0.0, 1.0]))
    for reach, step in _TILTS:
        tilts = np.arange(-reach, reach + 0.5 * step, step)
        x, y = (np.tan(np.radians(grid.ravel())) for grid in np.meshgrid(tilts, tilts))
        tried = np.column_stack([x, y, np.ones(len(x))]) @ axes
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        axes = rotation_between(tried[int(np.argmax(crowd(tried)))], np.array([0.0, 0.0, 1.0]))
    yaw = 0.0
    for angles in (np.arange(0.0, 90.0, 1.0), np.arange(-1.0, 1.05, 0.1)):
        turns = np.radians(yaw + angles)
        first = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(len(turns))]) @ axes
        second = np.column_stack([-np.sin(turns), np.cos(turns), np.zeros(len(turns))]) @ axes
        yaw += float(angles[int(np.argmax(crowd(first) + crowd(second)))])
    sine, cosine = np.sin(np.radians(yaw)), np.cos(np.radians(yaw))
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ axes


def levels(heights: np.ndarray, eyes: np.ndarray, width: float) -> tuple[Level, Level]:
    """Floor and ceiling: the outermost heights at which many points lie, with all cameras between.

    Args:
        heights: (N,) of the points.
        eyes: (C,) of the cameras.
        width: how far points of a plane lie apart.
    """
    floor = _outermost(heights, float(eyes.min()), width)
    ceiling = _outermost(-heights, float(-eyes.max()), width)
    return floor, Level(-ceiling.at, ceiling.found)


def _outermost(values: np.ndarray, bound: float, width: float) -> Level:
    """The lowest crowded value below a bound, else the lowest percentile."""
    ordered = np.sort(values)
    counts = crowding(ordered, width)
    crowded = (counts >= _LEVEL_SHARE * len(ordered)) & (ordered < bound - width)
    crowded &= np.arange(len(ordered)) <= _BEYOND * len(ordered)
    if not crowded.any():
        return Level(float(min(np.percentile(ordered, 1.0), bound - 4.0 * width)), False)
    first = ordered[crowded][0]
    near = crowded & (ordered <= first + 4.0 * width)  # the peak that begins there
    top = ordered[near][int(np.argmax(counts[near]))]
    return Level(float(np.median(ordered[np.abs(ordered - top) <= width])), True)


def wall_lines(points: np.ndarray, eyes: np.ndarray, width: float) -> list[Line]:
    """Lines of the floor plan on which many points lie, and four around all of them.

    Args:
        points: (N, 2) between floor and ceiling, in axes along most walls.
        eyes: (C, 2) of the cameras.
        width: how far points of a wall lie apart.
    """
    lines: list[Line] = []
    left = points
    angles = np.radians(np.arange(0.0, 180.0, 3.0))
    while len(lines) < 14 and len(left):
        best, most, support = None, 0.0, 0
        for angle in angles:
            normal = np.array([np.cos(angle), np.sin(angle)])
            values = np.sort(left @ normal)
            counts = crowding(values, width)
            peak = int(np.argmax(counts))
            straight = min(abs(normal[0]), abs(normal[1])) < 1e-9
            score = counts[peak] * (1.0 if straight else _FREE)
            if score > most:
                best, most, support = (normal, float(values[peak]), straight), score, int(counts[peak])
        if best is None or support < max(_WALL_POINTS, _WALL_SHARE * len(points)):
            break
        line = _fitted(left, *best, width)
        lines.append(line)
        left = left[np.abs(left @ line.normal - line.at) > 2.0 * width]
    return lines + _around(np.concatenate([points, eyes]), lines, width)


def _fitted(points: np.ndarray, normal: np.ndarray, at: float, straight: bool, width: float) -> Line:
    """The line through the points near another one; its direction stays where it is along an axis."""
    for _ in range(1 if straight else 4):
        near = points[np.abs(points @ normal - at) <= 1.5 * width]
        if not straight and len(near) > 2:
            direction = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2][0]
            turned = np.array([-direction[1], direction[0]])
            normal = turned if turned @ normal > 0.0 else -turned
        at = float(np.median(near @ normal)) if len(near) else at
    return Line(normal, at, True)


def _around(points: np.ndarray, lines: list[Line], width: float) -> list[Line]:
    """Lines beyond nearly all points, where no wall was found near."""
    found = []
    for axis in (0, 1):
        for share, sign in ((0.5, -1.0), (99.5, 1.0)):
            normal = np.eye(2)[axis]
            at = float(np.percentile(points[:, axis], share)) + sign * width
            if not any(
                abs(line.normal @ normal) > 0.99 and abs(line.at - at) < 4.0 * width for line in lines
            ):
                found.append(Line(normal, at, False))
    return found
