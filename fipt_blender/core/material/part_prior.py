# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a part's surface tells of each of its points (empirical Bayes).

A part is one material: a painted wall has one colour, a carpet many. How far a part's values spread, beyond
the errors that they have, says which. Values are drawn to the part's middle as far as their errors exceed
that variety; what lies too far out for an error, as a picture on the wall does, is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# A stray value is any in [0, 1]: its spread about the middle.
STRAY = 12.0**-0.5
# Shares of strays, first guess and bounds, and the least variety.
FIRST_STRAYS, LEAST_STRAYS, MOST_STRAYS = 0.05, 1e-4, 0.5
LEAST_VARIETY = 1e-3
ROUNDS = 60
CHUNK = 1 << 20


@dataclass(frozen=True)
class PartPriors:
    """Distribution of values in each part.

    Attributes:
        parts: (P,) int64, rising.
        middle: (P, C).
        variety: (P,) standard deviation of true values about it, strays aside.
        strays: (P,) share of values that follow no rule.
    """

    parts: np.ndarray
    middle: np.ndarray
    variety: np.ndarray
    strays: np.ndarray


def part_priors(values: np.ndarray, errors: np.ndarray, part: np.ndarray) -> PartPriors:
    """Distributions of values that lie evenly on the surfaces, by expectation maximisation.

    Args:
        values: (K, C) in [0, 1].
        errors: (K,) standard error of each, root mean square of its channels.
        part: (K,) int, negative for none.
    """
    order = np.argsort(part, kind="stable")
    order = order[part[order] >= 0]
    parts, starts = np.unique(part[order], return_index=True)
    found = [_fit(values[rows], errors[rows]) for rows in np.split(order, starts[1:]) if len(rows)]
    middle, variety, strays = zip(*found, strict=True) if found else ((), (), ())
    shape = len(parts), values.shape[1]
    return PartPriors(
        parts.astype(np.int64), np.array(middle).reshape(shape), np.array(variety), np.array(strays)
    )


def drawn_to_parts(
    values: np.ndarray, errors: np.ndarray, part: np.ndarray, priors: PartPriors
) -> np.ndarray:
    """(N, C) posterior means of values with standard errors (N,) on parts (N,); other parts' as they are."""
    result = values.copy()
    if not len(priors.parts):
        return result
    for start in range(0, len(values), CHUNK):
        rows = slice(start, start + CHUNK)
        place = np.minimum(np.searchsorted(priors.parts, part[rows]), len(priors.parts) - 1)
        middle = priors.middle[place]
        offset = values[rows] - middle
        distance = np.sqrt((offset**2).mean(axis=1))
        variety = priors.variety[place] ** 2
        own = _regular(distance, variety + errors[rows] ** 2, priors.strays[place], values.shape[1])
        kept = own * variety / (variety + errors[rows] ** 2) + (1.0 - own)
        known = priors.parts[place] == part[rows]
        drawn = middle + offset * np.where(known, kept, 1.0)[:, None]
        result[rows] = np.where(known[:, None], drawn, values[rows])
    return result


def _fit(values: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Middle (C,), variety and share of strays of one part's values (n, C)."""
    channels = values.shape[1]
    weight = 1.0 / errors**2
    middle = np.array([_median(column, weight) for column in values.T])
    distance = np.sqrt(((values - middle) ** 2).mean(axis=1))
    variety = max(1.4826 * _median(distance, weight), LEAST_VARIETY) ** 2
    strays = FIRST_STRAYS
    for _ in range(ROUNDS):
        total = variety + errors**2
        own = _regular(distance, total, strays, channels)
        second = (variety / total * distance) ** 2 + variety * errors**2 / total
        variety = max(float((own * second).sum() / max(own.sum(), 1e-9)), LEAST_VARIETY**2)
        strays = float(np.clip(((1.0 - own).sum() + 0.5) / (len(own) + 1), LEAST_STRAYS, MOST_STRAYS))
    return middle, float(np.sqrt(variety)), strays


def _regular(
    distance: np.ndarray, variance: np.ndarray, strays: np.ndarray | float, channels: int
) -> np.ndarray:
    """(n,) probability that values at these distances from the middle are no strays.

    Args:
        distance: root mean square of the channels.
        variance: of the distance of regular values, a channel.
    """
    power = 0.5 * channels
    regular = (1.0 - strays) * np.exp(-power * distance**2 / variance) / variance**power
    stray = strays * np.exp(-power * distance**2 / STRAY**2) / STRAY**channels
    return regular / (regular + stray + 1e-300)


def _median(values: np.ndarray, weight: np.ndarray) -> float:
    """Weighted median."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
