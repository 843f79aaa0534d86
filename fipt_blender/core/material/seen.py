"""Which surfaces the photographs saw, and the values of the others.

An unseen point takes the median of its part, or the value of the nearest seen point if no pixel saw the part.
Textures, refinement and forward rendering share this rule.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..pixels.grouped import first_by_key, grouped_median, place_of
from ..pixels.store import PixelStore
from .groups import Units

RESOLUTION = 128  # cells along the room's longest side
# Cells along an axis with one more at each end, so that neighbours of the outermost cells have keys too.
SIDE = RESOLUTION + 2
# Number of seen points kept for the nearest-neighbour search.
SEEN_POINTS = 4096
CHUNK = 1 << 20


@dataclass(frozen=True)
class Box:
    """The cube to which positions are normalised: lowest corner and edge, metres."""

    low: np.ndarray
    extent: float

    def normalise(self, positions: np.ndarray) -> np.ndarray:
        """(N, 3) float32 positions in [0, 1] of world positions in metres, the nearest of those outside."""
        return np.clip((positions - self.low) / self.extent, 0.0, 1.0).astype(np.float32)


def room_box(bounds: tuple[np.ndarray, np.ndarray]) -> Box:
    """A cube slightly larger than a room of these bounds, metres."""
    low, high = bounds
    extent = float((high - low).max()) * 1.002
    return Box(low - 0.001 * extent, extent)


@dataclass(frozen=True)
class SeenCells:
    """Pairs of a cell of the normalised cube and a part of which some pixel saw a surface in that cell.

    Attributes:
        keys: (C,) int64, ascending: key of the pair (:func:`cell_keys`).
        points: (C, 3) float32 a surface point of each that was seen, world metres.
        part: (C,) int32, negative for none.
    """

    keys: np.ndarray
    points: np.ndarray
    part: np.ndarray

    def find(self, box: Box, positions: np.ndarray, part: np.ndarray) -> np.ndarray:
        """(N,) int64 index of the pair in which each point lies, or of a neighbouring one; -1 if unseen.

        Neighbours count because pixels may be wider than cells.
        """
        result = np.full(len(positions), -1, np.int64)
        for start in range(0, len(positions), CHUNK):
            rows = slice(start, start + CHUNK)
            result[rows] = self._find(cell_keys(box, positions[rows], part[rows]))
        return result

    def _find(self, wanted: np.ndarray) -> np.ndarray:
        # Many points lie in one cell, and mostly one after another: only the first of each run is sorted.
        begins = np.append(True, wanted[1:] != wanted[:-1])[: len(wanted)]
        wanted, cell = np.unique(wanted[begins], return_inverse=True)
        cell = cell[np.cumsum(begins) - 1]
        result = np.full(len(wanted), -1, np.int64)
        # The cell itself first, then its neighbours over faces, edges and corners; keys of neighbours differ
        # by a constant.
        steps = sorted(itertools.product((0, -1, 1), repeat=3), key=lambda step: sum(map(abs, step)))
        missing = np.arange(len(wanted))
        for step in _flat(np.array(steps)):
            result[missing] = place_of(self.keys, wanted[missing] + step)
            missing = missing[result[missing] < 0]
        return result[cell]


def find_seen_cells(pixels: PixelStore, units: Units, box: Box) -> SeenCells:
    """The cells in which the pixels of a run saw the units of the mesh."""

    def views() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for index in range(len(pixels.views)):
            triangle = np.asarray(pixels.triangle[pixels.rows(index)])
            hit = triangle >= 0
            yield np.asarray(pixels.position[pixels.rows(index)])[hit], units.triangle[triangle[hit]]

    return seen_cells(box, views())


def seen_cells(box: Box, views: Iterable[tuple[np.ndarray, np.ndarray]]) -> SeenCells:
    """The pairs of cell and part in which surface points were seen.

    Args:
        views: for each view, of which there is at least one, positions (n, 3), world metres, and their parts
            (n,) int, negative for none.
    """
    keyed = ((cell_keys(box, points, part), points.astype(np.float32)) for points, part in views)
    keys, points = first_by_key(keyed)
    return SeenCells(keys, points, (keys // SIDE**3 - 1).astype(np.int32))


def cell_keys(box: Box, positions: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(N,) int64 key of the pair of cell and part of each point."""
    return (np.maximum(part.astype(np.int64), -1) + 1) * SIDE**3 + _flat(_cells(box, positions))


def _cells(box: Box, positions: np.ndarray) -> np.ndarray:
    return np.clip((box.normalise(positions) * RESOLUTION).astype(np.int64), 0, RESOLUTION - 1) + 1


def _flat(cells: np.ndarray) -> np.ndarray:
    return (cells[:, 0] * SIDE + cells[:, 1]) * SIDE + cells[:, 2]


@dataclass(frozen=True)
class SeenStatistics:
    """Values of the seen points of a room.

    Attributes:
        medians: (U, C) of the values of each part, NaN without any.
        positions: (S, 3) a subset of the seen points, world metres.
        values: (S, C) of this subset.
    """

    medians: np.ndarray
    positions: np.ndarray
    values: np.ndarray


def unit_medians(values: np.ndarray, unit: np.ndarray, units: int) -> np.ndarray:
    """(units, C) median of the values (N, C) of each unit ((N,) int, negative for none); NaN without any."""
    known = unit >= 0
    medians = grouped_median(values[known], unit[known], units)
    medians[np.bincount(unit[known], minlength=units) == 0] = np.nan
    return medians


def seen_statistics(
    positions: np.ndarray, part: np.ndarray, values: np.ndarray, parts: int
) -> SeenStatistics:
    """Medians of so many parts and a subset of the points, which should lie evenly on the seen surfaces.

    Args:
        positions: (N, 3) world metres. part: (N,) int, negative for none. values: (N, C) float32.
    """
    stride = max(len(positions) // SEEN_POINTS, 1)
    return SeenStatistics(unit_medians(values, part, parts), positions[::stride], values[::stride])


def fallback_values(positions: np.ndarray, part: np.ndarray, statistics: SeenStatistics) -> np.ndarray:
    """(N, C) float32 values of unseen points.

    Args:
        positions: (N, 3) world metres. part: (N,) int, negative for none.
        statistics: of at least one seen point.
    """
    without_part = np.full((1, statistics.medians.shape[1]), np.nan, np.float32)
    result = np.append(statistics.medians, without_part, axis=0)[np.maximum(part, -1)]
    unseen_part = np.isnan(result[:, 0])
    if unseen_part.any():
        nearest = cKDTree(statistics.positions).query(positions[unseen_part], workers=-1)[1]
        result[unseen_part] = statistics.values[nearest]
    return result
