# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shrinkage towards parts removes noise, and keeps true spread and outliers."""

import numpy as np
import pytest

from fipt_blender.core.material.part_prior import part_priors, shrink_to_parts
from samples.small_rooms import agree

COUNT = 4000
MEDIAN = np.array([0.6, 0.5, 0.4])


def surface(spread: float, error: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True values (N, 3), estimates of them, and the standard errors of these (N,), which differ."""
    rng = np.random.default_rng(seed)
    true = MEDIAN + rng.normal(size=(COUNT, 3)) * spread
    errors = error * rng.choice([0.5, 1.0, 2.0], COUNT)
    return true, true + rng.normal(size=(COUNT, 3)) * errors[:, None], errors


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize(("spread", "error"), [(0.0, 0.05), (0.02, 0.04), (0.05, 0.05), (0.08, 0.02)])
def test_errors_are_those_of_the_best_linear_estimate(spread: float, error: float) -> None:
    """The mean square error is tau^2 e^2 / (tau^2 + e^2), the least that a linear estimate can have."""
    true, estimates, errors = surface(spread, error, 1)
    part = np.zeros(COUNT, int)
    priors = part_priors(estimates, errors, part, 1)
    assert priors.outliers[0] < 0.02
    assert abs(priors.spread[0] - spread) < 0.1 * spread + 0.013  # small spreads converge slowly
    shrunk = shrink_to_parts(estimates, errors, part, priors)
    for level in np.unique(errors):
        rows = errors == level
        squares = ((shrunk[rows] - true[rows]) ** 2).mean(axis=1)
        best = spread**2 * level**2 / (spread**2 + level**2)
        # The median has an error too, and so has a spread of 0.01 where there is none.
        excess = np.maximum(np.abs(squares.mean() - best) - 0.05 * best - 3e-5, 0.0)
        agree(np.array([excess]), np.array([squares.std() / np.sqrt(len(squares))]))


def test_a_picture_on_the_wall_stays() -> None:
    _, estimates, errors = surface(0.0, 0.03, 2)
    picture = np.arange(80)
    estimates[picture] = [0.2, 0.2, 0.3]
    part = np.zeros(COUNT, int)
    shrunk = shrink_to_parts(estimates, errors, part, part_priors(estimates, errors, part, 1))
    np.testing.assert_allclose(shrunk[picture], estimates[picture], atol=0.01)
    assert rms(shrunk[80:] - MEDIAN) < 0.15 * rms(estimates[80:] - MEDIAN)


def test_parts_are_separate_and_other_values_unchanged() -> None:
    _, estimates, errors = surface(0.0, 0.05, 3)
    part = np.arange(COUNT) % 4 - 1
    estimates[part == 2] -= 0.3
    priors = part_priors(estimates, errors, part, 8)
    assert np.flatnonzero(np.isfinite(priors.spread)).tolist() == [0, 1, 2]
    shrunk = shrink_to_parts(estimates, errors, part, priors)
    assert (shrunk[part == -1] == estimates[part == -1]).all()
    for index, median in ((0, MEDIAN), (1, MEDIAN), (2, MEDIAN - 0.3)):
        assert rms(shrunk[part == index] - median) < 0.15 * rms(estimates[part == index] - median)
    unknown = shrink_to_parts(estimates[:4], errors[:4], np.full(4, 7), priors)
    assert (unknown == estimates[:4]).all()
    nothing = part_priors(estimates, errors, np.full(COUNT, -1), 8)
    assert (shrink_to_parts(estimates, errors, part, nothing) == estimates).all()
