# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The floor plan that lines of walls enclose: the cells between them that are inside, by a minimum cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

_MARGIN = 0.1  # of the extent, around all points
_UNIT = 100_000  # capacities are integers
# Leaving out a hundredth of the points costs as much as a tenth of the room's size of wall without points.
_POINT_COST = 10.0
_WALL_COST = 0.1  # of a wall with points, over one without
_DENSE = 0.3  # a wall has points where their density is this share of that of all walls


@dataclass(frozen=True, eq=False)
class Line:
    """A line of the floor plan: normal (2,) @ position = at; `found` if points lie on it."""

    normal: np.ndarray
    at: float
    found: bool


@dataclass(frozen=True, eq=False)
class Wall:
    """A side of the plan: its ends (2, 2), which have the room on their left, and its line."""

    ends: np.ndarray
    line: Line


@dataclass(frozen=True, eq=False)
class Plan:
    """A floor plan.

    Attributes:
        corners: (K, 2).
        cells: indices of the corners of convex cells, counterclockwise.
        walls: what bounds them.
    """

    corners: np.ndarray
    cells: tuple[tuple[int, ...], ...]
    walls: tuple[Wall, ...]

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(N,) whether points (N, 2) lie inside."""
        inside = np.zeros(len(points), bool)
        for cell in self.cells:
            inside |= _in_cell(points, self.corners[list(cell)])
        return inside


def cut_plan(points: np.ndarray, eyes: np.ndarray, lines: list[Line], width: float) -> Plan:
    """The part of the plane between lines in which the points and all cameras are.

    Args:
        points: (N, 2) between floor and ceiling.
        eyes: (C, 2) of the cameras.
        lines: possible walls; some of them lie around all points.
        width: how far points of a wall lie apart.
    """
    low, high = np.percentile(np.concatenate([points, eyes]), [0.5, 99.5], axis=0)
    low, high = np.minimum(low, eyes.min(axis=0)), np.maximum(high, eyes.max(axis=0))
    size = float(np.linalg.norm(high - low))
    low, high = low - _MARGIN * size, high + _MARGIN * size
    frame = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    cells = [frame]
    for line in lines:
        cells = [part for cell in cells for part in _split(cell, line, 1e-9 * size)]
    corners, cells_of = _welded(cells, 1e-6 * size)
    sides = _sides(cells_of)
    near = np.stack([np.abs(points @ line.normal - line.at) <= 2.0 * width for line in lines])
    loose = points[~near.any(axis=0)]
    inner = np.array([_in_cell(loose, corners[list(cell)]).sum() for cell in cells_of]) / max(len(points), 1)
    held = np.array([_in_cell(eyes, corners[list(cell)]).any() for cell in cells_of])
    owner = {side: _line_of(corners[list(side)], lines, 1e-6 * size) for side in sides}
    dense = near.sum() / max(
        sum(_length(points[row], line) for row, line in zip(near, lines, strict=True)), 1e-9
    )
    costs = {}
    for side, number in owner.items():
        ends = corners[list(side)]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        share = 0.0
        if number >= 0 and length > 0.0:
            along = (points[near[number]] - ends[0]) @ (ends[1] - ends[0]) / length
            count = ((along > -width) & (along < length + width)).sum()
            share = min(count / (_DENSE * dense * (length + 2.0 * width)), 1.0)
        costs[side] = length / size * (1.0 - (1.0 - _WALL_COST) * share)
    inside = _cut(sides, costs, _POINT_COST * inner, held, len(cells_of))
    return _plan(corners, cells_of, sides, owner, lines, inside)


def _length(points: np.ndarray, line: Line) -> float:
    """Length of the part of a line on which points lie."""
    if not len(points):
        return 0.0
    along = points @ np.array([-line.normal[1], line.normal[0]])
    low, high = np.percentile(along, [5.0, 95.0])
    return float(high - low)


def _split(cell: np.ndarray, line: Line, least: float) -> list[np.ndarray]:
    """The parts of a convex polygon (K, 2) on both sides of a line."""
    away = cell @ line.normal - line.at
    if (away <= least).all() or (away >= -least).all():
        return [cell]
    parts: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for index, corner in enumerate(cell):
        other = (index + 1) % len(cell)
        for part, sign in zip(parts, (1.0, -1.0), strict=True):
            if sign * away[index] >= -least:
                part.append(corner)
        if (away[index] > least and away[other] < -least) or (away[index] < -least and away[other] > least):
            place = corner + (cell[other] - corner) * away[index] / (away[index] - away[other])
            parts[0].append(place)
            parts[1].append(place)
    return [np.array(part) for part in parts]


def _welded(cells: list[np.ndarray], least: float) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Corners that cells share, and each cell's indices of them."""
    corners: list[np.ndarray] = []
    result = []
    for cell in cells:
        indices: list[int] = []
        for corner in cell:
            found = next((i for i, other in enumerate(corners) if np.abs(other - corner).max() < least), -1)
            if found < 0:
                corners.append(corner)
                found = len(corners) - 1
            if found not in indices:
                indices.append(found)
        if len(indices) > 2:
            result.append(tuple(indices))
    return np.array(corners), result


def _sides(cells: list[tuple[int, ...]]) -> dict[tuple[int, int], list[int]]:
    """The cells on each side of a pair of corners; the pair is as in its first cell."""
    sides: dict[tuple[int, int], list[int]] = {}
    for number, cell in enumerate(cells):
        for start, end in zip(cell, cell[1:] + cell[:1], strict=True):
            key = (end, start) if (end, start) in sides else (start, end)
            sides.setdefault(key, []).append(number)
    return sides


def _line_of(ends: np.ndarray, lines: list[Line], least: float) -> int:
    """Number of the line on which a side lies, -1 for the frame."""
    for number, line in enumerate(lines):
        if np.abs(ends @ line.normal - line.at).max() < least:
            return number
    return -1


def _cut(
    sides: dict[tuple[int, int], list[int]],
    costs: dict[tuple[int, int], float],
    inner: np.ndarray,
    held: np.ndarray,
    count: int,
) -> np.ndarray:
    """(count,) bool, the cells that the cheapest boundary between cameras and outside encloses."""
    inside, outside = count, count + 1
    entries: dict[tuple[int, int], int] = {}
    for side, cells in sides.items():
        capacity = round(_UNIT * costs[side])
        if len(cells) == 2:
            entries[(cells[0], cells[1])] = entries.get((cells[0], cells[1]), 0) + capacity
            entries[(cells[1], cells[0])] = entries.get((cells[1], cells[0]), 0) + capacity
        elif not held[cells[0]]:
            entries[(cells[0], outside)] = 1000 * _UNIT
    for cell in range(count):
        amount = 1000 * _UNIT if held[cell] else round(_UNIT * float(inner[cell]))
        if amount:
            entries[(inside, cell)] = amount
    rows, columns = zip(*entries, strict=True)
    graph = csr_matrix(
        (np.array(list(entries.values()), np.int32), (rows, columns)), (count + 2, count + 2), dtype=np.int32
    )
    flow = maximum_flow(graph, inside, outside).flow
    rest = graph - flow
    rest.data[rest.data < 0] = 0
    rest.eliminate_zeros()
    reached = breadth_first_order(rest, inside, return_predecessors=False)
    result = np.zeros(count, bool)
    result[[index for index in reached if index < count]] = True
    return result


def _plan(
    corners: np.ndarray,
    cells: list[tuple[int, ...]],
    sides: dict[tuple[int, int], list[int]],
    owner: dict[tuple[int, int], int],
    lines: list[Line],
    inside: np.ndarray,
) -> Plan:
    """The plan of the cells that are inside, with the sides of one wall joined."""
    walls: dict[tuple[int, bool], list[tuple[float, float]]] = {}
    for side, around in sides.items():
        within = [cell for cell in around if inside[cell]]
        if len(within) != 1 or owner[side] < 0:
            continue
        start, end = side if within[0] == around[0] else side[::-1]
        normal = lines[owner[side]].normal
        along = np.array([-normal[1], normal[0]])
        first, second = float(corners[start] @ along), float(corners[end] @ along)
        key = (owner[side], second > first)
        walls.setdefault(key, []).append((min(first, second), max(first, second)))
    found = []
    for (number, forward), parts in walls.items():
        line = lines[number]
        along = np.array([-line.normal[1], line.normal[0]])
        for low, high in _joined(parts):
            ends = line.at * line.normal + np.outer([low, high], along)
            found.append(Wall(ends if forward else ends[::-1], line))
    return Plan(
        corners, tuple(cell for cell, within in zip(cells, inside, strict=True) if within), tuple(found)
    )


def _joined(parts: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Intervals, those that touch as one."""
    result: list[tuple[float, float]] = []
    for low, high in sorted(parts):
        if result and low <= result[-1][1] + 1e-6 * max(abs(low), abs(high), 1.0):
            result[-1] = (result[-1][0], max(high, result[-1][1]))
        else:
            result.append((low, high))
    return result


def _in_cell(points: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(N,) whether points (N, 2) lie in a convex polygon (K, 2), counterclockwise."""
    inside = np.ones(len(points), bool)
    for start, end in zip(cell, np.roll(cell, -1, axis=0), strict=True):
        along = end - start
        inside &= along[0] * (points[:, 1] - start[1]) - along[1] * (points[:, 0] - start[0]) >= 0.0
    return inside
