# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shrinkage of the values of a part towards its median (empirical Bayes).

The values of a part are its median plus a true spread tau (none on a painted wall, large on a carpet), plus
the error of each value; a share of them are outliers, such as a picture on the wall. Median, tau and this
share are estimated from all values of the part. The posterior mean moves a value towards the median as far as
its error exceeds the spread, and leaves outliers as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robust import MAD_TO_DEVIATION
from ..scene.grouped import grouped_weighted_median, rows_of_groups
from .confidence import UNIFORM_DEVIATION

# Share of outliers: initial value and bounds.
FIRST_OUTLIERS, LEAST_OUTLIERS, MOST_OUTLIERS = 0.05, 1e-4, 0.5
LEAST_SPREAD = 1e-3
ITERATIONS = 60
CHUNK = 1 << 20


@dataclass(frozen=True)
class PartPriors:
    """Distribution of the values of each of P parts; NaN without any.

    Attributes:
        median: (P, C).
        spread: (P,) standard deviation tau of the true values around it, without outliers.
        outliers: (P,) share of outliers, which may have any value in [0, 1].
    """

    median: np.ndarray
    spread: np.ndarray
    outliers: np.ndarray


def part_priors(values: np.ndarray, errors: np.ndarray, part: np.ndarray, parts: int) -> PartPriors:
    """The distribution of each of so many parts, by expectation maximisation.

    Args:
        values: (K, C) in [0, 1], at points distributed evenly over the surfaces.
        errors: (K,) standard error of each, root mean square over its channels.
        part: (K,) int, negative for none.
    """
    priors = PartPriors(np.full((parts, values.shape[1]), np.nan), *np.full((2, parts), np.nan))
    for index, rows in enumerate(rows_of_groups(part, parts)):
        if len(rows):
            fit = _fit(values[rows], errors[rows])
            priors.median[index], priors.spread[index], priors.outliers[index] = fit
    return priors


def shrink_to_parts(
    values: np.ndarray, errors: np.ndarray, part: np.ndarray, priors: PartPriors
) -> np.ndarray:
    """(N, C) posterior means of values (N, C); values of parts without a prior are unchanged.

    Args:
        errors: (N,) standard errors.
        part: (N,) int.
    """
    result = values.copy()
    known = np.append(np.isfinite(priors.spread), False)[np.maximum(part, -1)]
    every = np.flatnonzero(known)
    for rows in np.split(every, range(CHUNK, len(every), CHUNK)):
        place = part[rows]
        median = priors.median[place]
        offset = values[rows] - median
        distance = np.sqrt((offset**2).mean(axis=1))
        variance = priors.spread[place] ** 2
        total = variance + errors[rows] ** 2
        inlier = _inlier_probability(distance, total, priors.outliers[place], values.shape[1])
        factor = inlier * variance / total + (1.0 - inlier)
        result[rows] = median + offset * factor[:, None]
    return result


def _fit(values: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Median (C,), spread and share of outliers of one part's values (n, C)."""
    channels = values.shape[1]
    weight = 1.0 / errors**2
    median = np.array([_weighted_median(column, weight) for column in values.T])
    distance = np.sqrt(((values - median) ** 2).mean(axis=1))
    variance = max(MAD_TO_DEVIATION * _weighted_median(distance, weight), LEAST_SPREAD) ** 2
    outliers = FIRST_OUTLIERS
    for _ in range(ITERATIONS):
        total = variance + errors**2
        inlier = _inlier_probability(distance, total, outliers, channels)
        second_moment = (variance / total * distance) ** 2 + variance * errors**2 / total
        variance = float((inlier * second_moment).sum() / max(inlier.sum(), 1e-9))
        variance = max(variance, LEAST_SPREAD**2)
        outliers = ((1.0 - inlier).sum() + 0.5) / (len(inlier) + 1)
        outliers = float(np.clip(outliers, LEAST_OUTLIERS, MOST_OUTLIERS))
    return median, float(np.sqrt(variance)), outliers


def _inlier_probability(
    distance: np.ndarray, variance: np.ndarray, outliers: np.ndarray | float, channels: int
) -> np.ndarray:
    """(n,) probability that values are no outliers.

    Args:
        distance: (n,) root mean square over the channels of the distance from the median.
        variance: (n,) of an inlier's distance, per channel.
        outliers: share of outliers.
    """
    power = 0.5 * channels
    inlier = (1.0 - outliers) * np.exp(-power * distance**2 / variance) / variance**power
    outlier = outliers * np.exp(-power * distance**2 / UNIFORM_DEVIATION**2) / UNIFORM_DEVIATION**channels
    return inlier / (inlier + outlier + 1e-300)


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    return float(grouped_weighted_median(values, weight, np.zeros(len(values), np.int64), 1)[0])
