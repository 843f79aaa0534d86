# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which surfaces photographs saw, and what stands in for the others: their part's median, else the nearest
seen point. The one rule for textures, for refinement and for forward rendering.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

RESOLUTION = 128
# Cells along an axis with one more at each end, so that neighbours of the outermost have numbers too.
SIDE = RESOLUTION + 2
# Seen points kept for the nearest-neighbour search, and the cells along the room in which unseen ones share.
SEEN_POINTS = 4096
CELLS = 64
CHUNK = 1 << 20


@dataclass(frozen=True)
class Box:
    """The cube to which positions are normalised: lowest corner and edge, metres."""

    low: np.ndarray
    extent: float

    def normalise(self, positions: np.ndarray) -> np.ndarray:
        """(N, 3) float32 positions in [0, 1] of world positions in metres."""
        return ((positions - self.low) / self.extent).astype(np.float32)


def room_box(bounds: tuple[np.ndarray, np.ndarray]) -> Box:
    """The cube around a room's bounds, a little larger."""
    low, high = bounds
    extent = float((high - low).max()) * 1.002
    return Box(low - 0.001 * extent, extent)


@dataclass(frozen=True)
class SeenCells:
    """Pairs of a cell of the room's cube and a part of which some pixel saw a surface.

    Attributes:
        keys: (K,) int64, rising; a pair's number (:func:`cell_keys`).
        points: (K, 3) float32 world, a surface point of each that was seen.
        part: (K,) int32, negative for none.
    """

    keys: np.ndarray
    points: np.ndarray
    part: np.ndarray

    def find(self, box: Box, positions: np.ndarray, part: np.ndarray) -> np.ndarray:
        """(N,) int64 index of the pair in which each point lies, or of one beside it; -1 where none was seen.

        Neighbours count because pixels may be wider than cells.
        """
        result = np.full(len(positions), -1, np.int64)
        for start in range(0, len(positions), CHUNK):
            rows = slice(start, start + CHUNK)
            result[rows] = self._find(cell_keys(box, positions[rows], part[rows]))
        return result

    def _find(self, wanted: np.ndarray) -> np.ndarray:
        found = np.full(len(wanted), -1, np.int64)
        if not len(self.keys):
            return found
        # Own cell first, then faces, edges and corners; the number of a neighbour differs by a constant.
        steps = sorted(itertools.product((0, -1, 1), repeat=3), key=lambda step: sum(map(abs, step)))
        lost = np.arange(len(wanted))
        for step in _flat(np.array(steps)):
            keys = wanted[lost] + step
            place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            hit = self.keys[place] == keys
            found[lost[hit]] = place[hit]
            lost = lost[~hit]
        return found


def seen_cells(box: Box, pieces: Iterable[tuple[np.ndarray, np.ndarray]]) -> SeenCells:
    """The pairs of cell and part in which pixels saw surface points.

    Args:
        pieces: positions (n, 3), world, and part (n,) int of them, negative for none; view by view.
    """
    keys, points = np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
    parts = np.zeros(0, np.int32)
    for positions, part in pieces:
        new, place = np.unique(cell_keys(box, positions, part), return_index=True)
        keys, chosen = np.unique(np.concatenate([keys, new]), return_index=True)
        points = np.concatenate([points, positions[place].astype(np.float32)])[chosen]
        parts = np.concatenate([parts, part[place].astype(np.int32)])[chosen]
    return SeenCells(keys, points, parts)


def cell_keys(box: Box, positions: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(N,) int64 number of the pair of cell and part of each point."""
    return (np.maximum(part.astype(np.int64), -1) + 1) * SIDE**3 + _flat(_cells(box, positions))


def _cells(box: Box, positions: np.ndarray) -> np.ndarray:
    return np.clip((box.normalise(positions) * RESOLUTION).astype(np.int64), 0, RESOLUTION - 1) + 1


def _flat(cells: np.ndarray) -> np.ndarray:
    return (cells[:, 0] * SIDE + cells[:, 1]) * SIDE + cells[:, 2]


@dataclass(frozen=True)
class SeenStatistics:
    """What is known of the seen points of a room.

    Attributes:
        parts: (P,) int64 parts with a seen point, rising.
        medians: (P, C) of the values in each of them.
        positions: (S, 3) a spread of seen points.
        values: (S, C) there.
    """

    parts: np.ndarray
    medians: np.ndarray
    positions: np.ndarray
    values: np.ndarray


def seen_statistics(positions: np.ndarray, part: np.ndarray, values: np.ndarray) -> SeenStatistics:
    """Medians of parts and a spread of points; the points given should lie evenly on what was seen.

    Args:
        positions: (N, 3) world. part: (N,), negative for none. values: (N, C).
    """
    order = np.argsort(part, kind="stable")
    ids, starts = np.unique(part[order], return_index=True)
    groups = np.split(order, starts[1:]) if len(order) else []
    medians = [np.median(values[group], axis=0) for group in groups]
    known = ids >= 0
    stride = max(len(positions) // SEEN_POINTS, 1)
    return SeenStatistics(
        ids[known].astype(np.int64),
        np.array(medians, np.float32).reshape(len(ids), values.shape[1])[known],
        positions[::stride],
        values[::stride],
    )


def stand_ins(positions: np.ndarray, part: np.ndarray, statistics: SeenStatistics) -> np.ndarray:
    """Values for points that no photograph saw.

    Args:
        positions: (N, 3) world. part: (N,), negative for none.
        statistics: of at least one seen point.

    Returns:
        (N, C) float32.
    """
    result = np.empty((len(positions), statistics.values.shape[1]), np.float32)
    orphan = np.ones(len(positions), bool)
    if len(statistics.parts):
        place = np.minimum(np.searchsorted(statistics.parts, part), len(statistics.parts) - 1)
        orphan = statistics.parts[place] != part
        result[~orphan] = statistics.medians[place[~orphan]]
    if orphan.any():
        result[orphan] = statistics.values[_nearest(positions[orphan], statistics.positions)]
    return result


def _nearest(positions: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Index of the candidate nearest to the middle of each position's cell."""
    low = candidates.min(axis=0)
    size = max(float((candidates.max(axis=0) - low).max()) / CELLS, 1e-9)
    cell = np.floor((positions - low) / size).astype(np.int64)
    origin = cell.min(axis=0)
    shape = cell.max(axis=0) - origin + 1
    # One number a cell: sorting rows would take many times as long.
    keys, inverse = np.unique(np.ravel_multi_index((cell - origin).T, shape), return_inverse=True)
    centres = low + (np.stack(np.unravel_index(keys, shape), axis=1) + origin + 0.5) * size
    nearest = np.empty(len(centres), np.int64)
    for first in range(0, len(centres), 1024):
        block = centres[first : first + 1024]
        distance = ((block[:, None] - candidates[None]) ** 2).sum(axis=2)
        nearest[first : first + 1024] = distance.argmin(axis=1)
    return nearest[inverse.ravel()]
