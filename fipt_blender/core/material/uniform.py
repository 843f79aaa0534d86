# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of one colour: those whose values vary so little that their standard errors explain it.

A painted wall is one, a carpet is not, and neither is a wall with a picture in its mask. What remains of
blotches where light was wrong by a few percent goes with the part's median.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from .part_prior import PartPriors

# The true spread of a part's values is not resolved below this share of their typical standard error.
RESOLVED = 0.5
# A place differs if it and its neighbours are so many of their standard errors off the median on average:
# edges are wrong by three to four in single cells, pictures and patterns by five to ten in all of them.
NEIGHBOURS, SURE = 9, 4.0
# Share of a part's places that may differ.
LEAST_SHARE = 0.01


def uniform_parts(
    values: np.ndarray, errors: np.ndarray, part: np.ndarray, points: np.ndarray, priors: PartPriors
) -> np.ndarray:
    """(P,) bool, parts of one colour, for P parts with priors.

    Args:
        values: (K, C) at points distributed evenly over the surfaces.
        errors: (K,) standard error of each, root mean square over its channels.
        part: (K,) int, negative for none.
        points: (K, 3) metres.
    """
    uniform = np.zeros(len(priors.spread), bool)
    order = np.argsort(part, kind="stable")
    bounds = np.searchsorted(part[order], np.arange(len(uniform) + 1))
    for index, rows in enumerate(np.split(order, bounds)[1:-1]):
        if not len(rows) or priors.spread[index] >= RESOLVED * np.median(errors[rows]):
            continue
        offset = values[rows] - priors.median[index]
        uniform[index] = _differing(offset, errors[rows], points[rows]) < LEAST_SHARE
    return uniform


def _differing(offset: np.ndarray, errors: np.ndarray, points: np.ndarray) -> float:
    """Share of places whose surroundings are off the median for certain; offset (n, C), errors (n,)."""
    count = min(NEIGHBOURS, len(points))
    around = cKDTree(points).query(points, count)[1].reshape(len(points), count)
    distance = np.sqrt((offset[around].mean(axis=1) ** 2).mean(axis=1))
    expected = np.sqrt((errors[around] ** 2).mean(axis=1))
    return float(np.mean(distance > SURE * expected))
