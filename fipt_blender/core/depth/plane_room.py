# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed room of planes that fits the sparse points of a camera solve: floor, ceiling, walls and boxes.

A stand-in for captures without a mesh. Walls are vertical, most of them at right angles; which of them bound
the room is a minimum cut of the floor plan (as in Oesau et al. 2014): few walls without points, few points
left outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.errors import FiptError
from .floor_plan import Plan, cut_plan
from .plane_search import LEAST_POINTS, level_axes, levels, wall_lines

_BOX_STEP = 4.0  # widths: cells of the floor plan in which furniture is gathered
_BOX_POINTS = 15  # fewer, or a smaller share than below, are no piece of furniture
_BOX_SPREAD = (3.0, 97.0)  # percentiles of the points that a box holds
_STANDS = 0.3  # of the room's height: boxes that begin lower reach down to the floor


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of the room.

    Attributes:
        name: "Floor", "Ceiling", "Wall.001", ..., "Box.001", ...
        vertices: (V, 3) float64 in the coordinates of the points.
        faces: vertex indices of each polygon; seen from the room they are counterclockwise.
    """

    name: str
    vertices: np.ndarray
    faces: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, eq=False)
class PlaneRoom:
    """The room.

    Attributes:
        pieces: floor and ceiling first, then walls and boxes.
        guessed: names of those that no points support: they close the room at its outermost points.
    """

    pieces: tuple[Piece, ...]
    guessed: tuple[str, ...]


def plane_room(points: np.ndarray, cameras: np.ndarray, up: np.ndarray) -> PlaneRoom:
    """Fit a room to the points of a solve.

    Args:
        points: (N, 3) of the solve, in any unit.
        cameras: (C, 3) positions, all of them inside the room.
        up: (3,) approximate up direction, up to 20 degrees off.

    Raises:
        FiptError: ``room-points`` where there are too few points.
    """
    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < LEAST_POINTS:
        raise FiptError(
            "room-points",
            f"The camera solve has {len(points)} points; a room of planes needs at least {LEAST_POINTS}.",
            "Model the room by hand, or solve the cameras with more photographs.",
        )
    axes = level_axes(points, up)
    local, eyes = points @ axes.T, np.asarray(cameras, np.float64) @ axes.T
    low, high = np.percentile(np.concatenate([local, eyes]), [1.0, 99.0], axis=0)
    width = 0.005 * float(np.linalg.norm(high - low))
    floor, ceiling = levels(local[:, 2], eyes[:, 2], width)
    inside = (local[:, 2] > floor.at + 2.0 * width) & (local[:, 2] < ceiling.at - 2.0 * width)
    lines = wall_lines(local[inside, :2], eyes[:, :2], width)
    plan = cut_plan(local[inside, :2], eyes[:, :2], lines, width)
    pieces = [_floor("Floor", plan, floor.at, up=True), _floor("Ceiling", plan, ceiling.at, up=False)]
    guessed = [name for name, level in (("Floor", floor), ("Ceiling", ceiling)) if not level.found]
    for number, wall in enumerate(plan.walls, 1):
        name = f"Wall.{number:03d}"
        pieces.append(_wall(name, wall.ends, floor.at, ceiling.at))
        guessed += [] if wall.line.found else [name]
    boxes = _boxes(local[inside], eyes, plan, (floor.at, ceiling.at), width)
    pieces += [_box(f"Box.{number:03d}", *box) for number, box in enumerate(boxes, 1)]
    turned = tuple(Piece(piece.name, piece.vertices @ axes, piece.faces) for piece in pieces)
    return PlaneRoom(turned, tuple(guessed))


def _floor(name: str, plan: Plan, height: float, up: bool) -> Piece:
    """Floor or ceiling: the convex cells of the floor plan."""
    used = sorted({index for cell in plan.cells for index in cell})
    row = {index: number for number, index in enumerate(used)}
    vertices = np.column_stack([plan.corners[used], np.full(len(used), height)])
    faces = [tuple(row[index] for index in cell) for cell in plan.cells]
    return Piece(name, vertices, tuple(face if up else face[::-1] for face in faces))


def _wall(name: str, ends: np.ndarray, floor: float, ceiling: float) -> Piece:
    """A wall over a side (2, 2) of the plan, which the room lies on the left of."""
    (ax, ay), (bx, by) = ends
    vertices = np.array([[ax, ay, floor], [bx, by, floor], [bx, by, ceiling], [ax, ay, ceiling]])
    return Piece(name, vertices, ((1, 0, 3, 2),))


def _boxes(
    points: np.ndarray, eyes: np.ndarray, plan: Plan, heights: tuple[float, float], width: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lowest and highest corners of upright boxes around clusters of points that lie on no plane."""
    from scipy.ndimage import label

    floor, ceiling = heights
    free = plan.contains(points[:, :2])
    for wall in plan.walls:
        free &= np.abs(points[:, :2] @ wall.line.normal - wall.line.at) > 3.0 * width
    free &= points[:, 2] > floor + 3.0 * width
    free &= points[:, 2] < ceiling - 3.0 * width
    points = points[free]
    if not len(points):
        return []
    step = _BOX_STEP * width
    start = points[:, :2].min(axis=0)
    cell = ((points[:, :2] - start) / step).astype(int)
    taken = np.zeros(cell.max(axis=0) + 1, bool)
    taken[tuple(cell.T)] = True
    groups = label(taken, np.ones((3, 3)))[0][tuple(cell.T)]
    found = []
    for group in range(1, groups.max() + 1):
        some = points[groups == group]
        if len(some) < max(_BOX_POINTS, 0.005 * len(points)):
            continue
        low, high = np.percentile(some, _BOX_SPREAD, axis=0)
        if low[2] < floor + _STANDS * (ceiling - floor):
            low[2] = floor
        holds = ((eyes > low) & (eyes < high)).all(axis=1)
        if (high - low).min() > 2.0 * width and not holds.any():
            found.append((low, high))
    return found


def _box(name: str, low: np.ndarray, high: np.ndarray) -> Piece:
    """An upright box, seen from outside."""
    x, y, z = zip(low, high, strict=True)
    vertices = np.array([[x[i & 1], y[i >> 1 & 1], z[i >> 2]] for i in range(8)])
    faces = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6))
    return Piece(name, vertices, faces)
