# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials for surface points that no photograph saw: their part's median, else the nearest seen point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Seen points kept for the nearest-neighbour search, and the cells along the room in which unseen ones share.
SEEN_POINTS = 4096
CELLS = 64


@dataclass
class SeenStatistics:
    """What is known of the seen points of a room."""

    part_median: dict[int, np.ndarray]  # part -> (C,)
    positions: np.ndarray  # (S,3) a spread of seen points
    values: np.ndarray  # (S,C)


def seen_statistics(
    points: Sequence[tuple[np.ndarray, np.ndarray]],
    samples: Sequence[tuple[np.ndarray, np.ndarray]],
) -> SeenStatistics:
    """Collect medians and a spread of seen points over all images.

    Args:
        points: of each image (positions (N,3), part (N,) with -1 for none).
        samples: of each image (values (N,C), coverage (N,)).
    """
    position = np.concatenate([each for each, _ in points])
    part = np.concatenate([each for _, each in points])
    values = np.concatenate([each for each, _ in samples])
    seen = np.concatenate([coverage for _, coverage in samples]) > 0.0
    position, part, values = position[seen], part[seen], values[seen]
    order = np.argsort(part, kind="stable")
    ids, starts = np.unique(part[order], return_index=True)
    medians = {
        int(name): np.median(values[group], axis=0)
        for name, group in zip(ids, np.split(order, starts[1:]), strict=False)
        if name >= 0
    }
    # Texels come in raster order, so that a stride spreads the points over all islands.
    stride = max(len(position) // SEEN_POINTS, 1)
    return SeenStatistics(medians, position[::stride], values[::stride])


def fill_unseen(
    values: np.ndarray,
    coverage: np.ndarray,
    positions: np.ndarray,
    part: np.ndarray,
    statistics: SeenStatistics,
) -> np.ndarray:
    """Replace the values of points with coverage 0.

    Args:
        values: (N,C).
        coverage: (N,) 0 to 1.
        positions: (N,3) world.
        part: (N,) -1 for none.
        statistics: of all images of the room.

    Returns:
        (N,C); unchanged where nothing at all was seen.
    """
    values = values.copy()
    unseen = np.flatnonzero(coverage <= 0.0)
    if not len(unseen) or not len(statistics.positions):
        return values
    orphan = np.ones(len(unseen), bool)
    for name in np.unique(part[unseen]):
        if int(name) in statistics.part_median:
            mine = part[unseen] == name
            values[unseen[mine]] = statistics.part_median[int(name)]
            orphan[mine] = False
    lost = unseen[orphan]
    if len(lost):
        values[lost] = statistics.values[_nearest(positions[lost], statistics.positions)]
    return values


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
