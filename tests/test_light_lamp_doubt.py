# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of the light of lamps that photographs hardly show, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.light.lamp_doubt import hardly_seen, power_errors
from fipt_blender.core.material.cell_errors import LitCells, add_light_errors
from fipt_blender.core.material.confidence import UNIFORM_DEVIATION
from samples.small_rooms import make_room

FLOOR = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]
UP = np.array([[0.0, 0.0, 1.0]])
AREA, LUMINANCE = 1e-4, 1000.0


def lamp_above(height: float) -> list:
    """A square of one centimetre that shines down."""
    return [
        [-0.005, -0.005, height],
        [-0.005, 0.005, height],
        [0.005, 0.005, height],
        [0.005, -0.005, height],
    ]


def fixture(quad: int, height: float) -> Fixture:
    triangles = np.array([2 * quad, 2 * quad + 1])
    shines = np.full(3, LUMINANCE)
    return Fixture(triangles, shines, np.zeros(3), AREA, np.array([0.0, 0.0, height]))


def test_lamps_that_few_pixels_see_alone_are_doubted_by_the_spread_of_their_radiance() -> None:
    room = make_room([FLOOR, lamp_above(0.5), lamp_above(1.0)])
    triangle = np.array([2] * 20 + [4] * 12)
    own = np.full((32, 3), 100.0, np.float32)
    own[20:26] *= 1.5
    pixels = SimpleNamespace(
        triangle=triangle, own=own, weight=np.full(32, 0.5), pure=np.arange(32) < 22, radiance=own
    )
    lamps = [fixture(1, 0.5), fixture(2, 1.0)]
    (doubt,) = hardly_seen(lamps, pixels, len(room.triangles))
    assert (doubt.index, doubt.pixels) == (1, 12) and doubt.spread == pytest.approx(0.2)
    surface = np.array([[0.3, 0.0, 0.75]]), UP  # below that lamp, above the other
    received = AREA * LUMINANCE / np.pi * 0.25**2 / (0.25**2 + 0.3**2) ** 2
    found = power_errors(room, lamps, [doubt], surface, 0)
    assert found[0] == pytest.approx(0.2 * received, rel=0.05)


def test_base_color_is_as_wrong_as_the_light() -> None:
    known = np.full((4, 3), 0.03, np.float32)
    points = np.zeros((2, 3))
    lit = LitCells(np.array([1, 3]), points, points, np.array([0.5, 0.8]), np.array([2.0, 0.1]))
    found = add_light_errors(known, lit, np.array([0.16, 1.0]))
    assert found[1, 0] == pytest.approx(np.hypot(0.03, 0.5 * 0.08))
    assert found[3, 0] == pytest.approx(UNIFORM_DEVIATION)
    assert np.array_equal(found[[0, 2]], known[[0, 2]]) and np.array_equal(found[:, 1:], known[:, 1:])
