# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Values drawn to their part's: noise goes, variety and single things stay."""

import numpy as np
import pytest
from small_rooms import agree

from fipt_blender.core.material.part_prior import drawn_to_parts, part_priors

COUNT = 4000
MIDDLE = np.array([0.6, 0.5, 0.4])


def surface(variety: float, error: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True values, what was found of them, and its standard errors, some better and some worse."""
    rng = np.random.default_rng(seed)
    true = MIDDLE + rng.normal(size=(COUNT, 3)) * variety
    errors = error * rng.choice([0.5, 1.0, 2.0], COUNT)
    return true, true + rng.normal(size=(COUNT, 3)) * errors[:, None], errors


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize(("variety", "error"), [(0.0, 0.05), (0.02, 0.04), (0.05, 0.05), (0.08, 0.02)])
def test_errors_are_those_of_the_best_linear_estimate(variety: float, error: float) -> None:
    """Its mean square is that of tau^2 e^2 / (tau^2 + e^2), which nothing linear can beat."""
    true, found, errors = surface(variety, error, 1)
    part = np.zeros(COUNT, int)
    priors = part_priors(found, errors, part)
    assert priors.strays[0] < 0.02
    assert abs(priors.variety[0] - variety) < 0.1 * variety + 0.013  # small ones are approached slowly
    drawn = drawn_to_parts(found, errors, part, priors)
    for spread in np.unique(errors):
        mine = errors == spread
        squares = ((drawn[mine] - true[mine]) ** 2).mean(axis=1)
        best = variety**2 * spread**2 / (variety**2 + spread**2)
        # The middle and a variety of 0.01 where there is none have errors, too.
        excess = np.maximum(np.abs(squares.mean() - best) - 0.05 * best - 3e-5, 0.0)
        agree(np.array([excess]), np.array([squares.std() / np.sqrt(len(squares))]))


def test_a_picture_on_the_wall_stays() -> None:
    _, found, errors = surface(0.0, 0.03, 2)
    picture = np.arange(80)
    found[picture] = [0.2, 0.2, 0.3]
    part = np.zeros(COUNT, int)
    drawn = drawn_to_parts(found, errors, part, part_priors(found, errors, part))
    np.testing.assert_allclose(drawn[picture], found[picture], atol=0.01)
    assert rms(drawn[80:] - MIDDLE) < 0.15 * rms(found[80:] - MIDDLE)


def test_parts_are_apart_and_the_rest_is_left() -> None:
    _, found, errors = surface(0.0, 0.05, 3)
    part = np.arange(COUNT) % 4 - 1
    found[part == 2] -= 0.3
    priors = part_priors(found, errors, part)
    assert priors.parts.tolist() == [0, 1, 2]
    drawn = drawn_to_parts(found, errors, part, priors)
    assert (drawn[part == -1] == found[part == -1]).all()
    for name, middle in ((0, MIDDLE), (1, MIDDLE), (2, MIDDLE - 0.3)):
        assert rms(drawn[part == name] - middle) < 0.15 * rms(found[part == name] - middle)
    unknown = drawn_to_parts(found[:4], errors[:4], np.full(4, 7), priors)
    assert (unknown == found[:4]).all()
    nothing = part_priors(found, errors, np.full(COUNT, -1))
    assert (drawn_to_parts(found, errors, part, nothing) == found).all()
