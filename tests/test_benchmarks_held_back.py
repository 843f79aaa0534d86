# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/held_back.py: renders are compared after one factor for each channel."""

import numpy as np
import pytest

from benchmarks.held_back import exposed


def test_the_factor_of_each_channel_is_found_beside_outliers() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0.1, 1.0, (20, 30, 3))
    photograph = image * [2.0, 0.5, 1.5]
    photograph[:4] = 9.0  # a fifth shows something else
    photograph[4, 0] = 0.0
    assert exposed(image, photograph) == pytest.approx(image * [2.0, 0.5, 1.5], rel=0.2)
    clean = image * [2.0, 0.5, 1.5]
    assert exposed(image, clean) == pytest.approx(clean)


def test_a_black_render_stays_black() -> None:
    assert not exposed(np.zeros((2, 2, 3)), np.ones((2, 2, 3))).any()
