"""Regions of single photographs, linked to parts of the room.

Networks segment each photograph on its own, often differently from the next one. Two surface points belong to
one part if most of the views that see both show them in one region.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from .components import graph_components

# Sets of cells are joined if at least this share of their pairs of pixels lies in one region.
LEAST_TOGETHER = 0.5
# Cells are first joined within blocks of this width, in cells, so that no chain of them crosses a border.
BLOCK = 4
# Most sets that are joined although they are not adjacent, those with the most pixels: all their pairs are in
# memory. Rooms have hundreds; there are more only where views hardly overlap.
MOST_SETS = 1000
_BESIDE = 1.8  # cells between neighbours, diagonal ones included


@dataclass(frozen=True)
class RegionPixels:
    """Pixels of one view that see the room and lie in a region.

    Attributes:
        region: (N,) int64 ids above 0, which mean nothing in other views.
        cell: (N,) int64 surface cell that each sees.
    """

    region: np.ndarray
    cell: np.ndarray


def link_regions(views: Sequence[RegionPixels], places: np.ndarray) -> np.ndarray:
    """The part of each surface cell, by average linkage.

    The similarity of two sets of cells is the share of the pairs of pixels, one of each set and both in one
    view, that lie in one region. Adjacent sets are joined first, the most similar pair before all others,
    then sets that are not adjacent.

    Args:
        views: of all photographs with regions.
        places: (C, 3) int place of each cell on a grid.

    Returns:
        (C,) int64 part of each cell, numbered from 0; cells without pixels have parts of their own.
    """
    if not len(places):
        return np.zeros(0, np.int64)
    counts, seen = _tables(views, len(places))
    pairs = cKDTree(places).query_pairs(_BESIDE, output_type="ndarray")
    one, other = pairs.T
    together = _products(counts, one, other)
    both = _products(seen, one, other)
    near = (places[one] // BLOCK == places[other] // BLOCK).all(axis=1)
    joined = near & (both > 0.0) & (together >= both)
    patch = graph_components(pairs[joined], len(places))
    gather = csr_array(
        (np.ones(len(patch)), (patch, np.arange(len(patch)))),
        shape=(int(patch.max(initial=-1)) + 1, len(patch)),
    )
    edges = np.unique(np.sort(patch[pairs], axis=1), axis=0)
    seen_by = (gather @ seen).toarray().astype(np.float64)
    sets = _Sets(gather @ counts, seen_by)
    part = sets.join(range(len(seen_by)), edges[edges[:, 0] != edges[:, 1]])
    live = np.unique(part)
    largest = live[np.argsort(-seen_by[live].sum(axis=1), kind="stable")[:MOST_SETS]]
    return np.unique(sets.join(largest.tolist())[part], return_inverse=True)[1].reshape(-1)[patch]


def _tables(views: Sequence[RegionPixels], count: int) -> tuple[csr_array, csr_array]:
    """(C, R) pixels of each cell in each region of any view, and (C, V) in each view."""
    cells, regions, of_view, total = [], [], [], 0
    for number, view in enumerate(views):
        ids, place = np.unique(view.region, return_inverse=True)
        cells.append(view.cell)
        regions.append(place + total)
        of_view.append(np.full(len(view.cell), number))
        total += len(ids)
    cell = np.concatenate(cells)
    ones = np.ones(len(cell), np.float32)
    # The constructor sums entries of the same row and column.
    counts = csr_array((ones, (cell, np.concatenate(regions))), shape=(count, total))
    return counts, csr_array((ones, (cell, np.concatenate(of_view))), shape=(count, len(views)))


def _products(table: csr_array, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N,) scalar products of rows of a table."""
    step = 200_000
    parts = [
        table[one[begin : begin + step]].multiply(table[other[begin : begin + step]]).sum(axis=1)
        for begin in range(0, len(one), step)
    ]
    return np.concatenate([np.zeros(0), *parts])


class _Sets:
    """Sets of cells that are joined.

    Args:
        counts: (S, R) pixels of each set in each region.
        seen: (S, V) float64 pixels of each set in each view; changed in place.
    """

    def __init__(self, counts: csr_array, seen: np.ndarray) -> None:
        counts.sort_indices()
        ends = counts.indptr[1:-1]
        self._regions, self._pixels = np.split(counts.indices, ends), np.split(counts.data, ends)
        self._seen = seen
        self._row = np.zeros(counts.shape[1])

    def join(self, among: Iterable[int], edges: np.ndarray | None = None) -> np.ndarray:
        """(S,) int64 set that each has joined, after the most similar pairs were joined one after the other.

        Args:
            among: sets that may join.
            edges: (E, 2) neighbours, which alone may join; None: all pairs.
        """
        alive, beside = set(among), None if edges is None else _neighbours(edges)
        joins, version = np.arange(len(self._seen)), np.zeros(len(self._seen), np.int64)
        heap: list[tuple[float, int, int, int, int]] = []

        def offer(one: int, least: int) -> None:
            others = sorted(other for other in (alive if beside is None else beside[one]) if other > least)
            for other, share in zip(others, self._together(one, others).tolist(), strict=True):
                if share > LEAST_TOGETHER and other != one:
                    heapq.heappush(heap, (-share, one, other, int(version[one]), int(version[other])))

        for one in sorted(alive):
            offer(one, one)
        while heap:
            _, one, other, *versions = heapq.heappop(heap)
            if versions != [version[one], version[other]]:
                continue
            self._join(one, other)
            joins[other] = one
            version[one] += 1
            version[other] = -1  # never offered again
            alive.discard(other)
            if beside is not None:
                for set_ in beside[other] - {one}:
                    beside[set_].discard(other)
                    beside[set_].add(one)
                beside[one] = (beside[one] | beside.pop(other)) - {one, other}
            offer(one, -1)
        while (joins[joins] != joins).any():
            joins = joins[joins]
        return joins

    def _together(self, one: int, others: Sequence[int] | np.ndarray) -> np.ndarray:
        """(n,) share of the pairs of pixels of a set and each of others that lie in one region."""
        if not len(others):
            return np.zeros(0)
        self._row[self._regions[one]] = self._pixels[one]
        regions, pixels = ([table[other] for other in others] for table in (self._regions, self._pixels))
        sums = np.cumsum(self._row[np.concatenate(regions)] * np.concatenate(pixels))
        self._row[self._regions[one]] = 0.0
        ends = np.cumsum([len(region) for region in regions])
        same = np.diff(np.append(0.0, sums)[np.append(0, ends)])
        both = self._seen[np.asarray(others)] @ self._seen[one]
        return np.divide(same, both, out=np.zeros(len(both)), where=both > 0.0)

    def _join(self, one: int, other: int) -> None:
        """Add a set to another, which keeps its number."""
        regions = np.concatenate([self._regions[one], self._regions[other]])
        self._regions[one], place = np.unique(regions, return_inverse=True)
        pixels = np.concatenate([self._pixels[one], self._pixels[other]])
        self._pixels[one] = np.bincount(place.reshape(-1), pixels)
        self._seen[one] += self._seen[other]


def _neighbours(edges: np.ndarray) -> dict[int, set[int]]:
    """The sets at the other ends of the edges (E, 2) of each set."""
    beside: dict[int, set[int]] = defaultdict(set)
    for one, other in edges.tolist():
        beside[one].add(other)
        beside[other].add(one)
    return beside
