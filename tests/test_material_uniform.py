# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Paint becomes one colour, whatever its errors; a pattern, and a picture on a wall, stay."""

import numpy as np
import pytest

from fipt_blender.core.material.part_prior import part_priors
from fipt_blender.core.material.uniform import uniform_parts

SIDE = 40
MEDIAN = np.array([0.6, 0.5, 0.4])


def is_uniform(change: np.ndarray, error: float = 0.02, noise: float = 1.0) -> bool:
    """Whether a square wall of this true change of its colour (SIDE, SIDE) is one colour."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), [0.0]), axis=-1).reshape(-1, 3) * 0.04
    values = MEDIAN + change.reshape(-1, 1) + rng.normal(size=(SIDE**2, 3)) * noise * error
    errors, part = np.full(SIDE**2, error), np.zeros(SIDE**2, int)
    priors = part_priors(values, errors, part, 2)
    uniform = uniform_parts(values, errors, part, grid, priors)
    assert not uniform[1]  # of which there is nothing
    return bool(uniform[0])


def blotch(height: float) -> np.ndarray:
    """A soft spot, as wrong light near a lamp leaves it."""
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    return height * np.exp(-((x - 10) ** 2 + (y - 25) ** 2) / 50.0)


@pytest.mark.parametrize("height", [0.0, 0.02, 0.035])  # up to 7 % of the colour
def test_paint_with_blotches_is_one_colour(height: float) -> None:
    assert is_uniform(blotch(height))


def test_what_is_certain_stays() -> None:
    stripes = np.tile(np.where(np.arange(SIDE) % 8 < 4, 0.05, -0.05), (SIDE, 1))
    assert not is_uniform(stripes)
    assert is_uniform(stripes, error=0.15, noise=0.2)  # nobody could tell
    picture = np.zeros((SIDE, SIDE))
    picture[10:18, 20:26] = -0.3
    assert not is_uniform(picture)


def test_single_wrong_cells_at_an_edge_do_not_count() -> None:
    edge = np.zeros((SIDE, SIDE))
    edge[0, ::3] = -0.2
    assert is_uniform(edge)
