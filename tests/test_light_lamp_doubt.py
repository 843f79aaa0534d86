# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of the light on a scan by the doubt about where its lamps are, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.light.lamp_doubt import hardly_seen, light_errors, power_errors
from fipt_blender.core.material.cell_errors import LitCells, add_light_errors
from fipt_blender.core.material.confidence import UNIFORM_DEVIATION
from samples.small_rooms import make_room

FLOOR = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]
UP = np.array([[0.0, 0.0, 1.0]])
AREA, LUMINANCE = 1e-4, 1000.0


def lamp_above(height: float) -> list:
    """A square of one centimetre that shines down."""
    return [[-0.005, -0.005, height], [-0.005, 0.005, height], [0.005, 0.005, height], [0.005, -0.005, height]]


def fixture(quad: int, height: float) -> Fixture:
    triangles = np.array([2 * quad, 2 * quad + 1])
    shines = np.full(3, LUMINANCE)
    return Fixture(triangles, shines, np.zeros(3), AREA, np.array([0.0, 0.0, height]))


def errors(quads: list, height: float, points: np.ndarray, doubt: float) -> np.ndarray:
    room = make_room([FLOOR, lamp_above(height), *quads])
    surface = points, np.repeat(UP, len(points), axis=0)
    return light_errors(room, [fixture(1, height)], surface, doubt, 0)


@pytest.mark.parametrize("height", [0.3, 0.6, 1.2])
def test_the_error_is_that_of_the_inverse_square(height: float) -> None:
    """Below a small lamp L_d is A L / (pi h^2); an error d of h changes it by 2 d / h."""
    doubt = 0.01
    found = errors([], height, np.zeros((1, 3)), doubt)
    light = AREA * LUMINANCE / (np.pi * height**2)
    assert found[0] == pytest.approx(2.0 * doubt / height * light, rel=0.05)


def test_where_a_shadow_ends_light_is_least_certain() -> None:
    """A board halfway between lamp and floor, whose edge's shadow lies below the lamp."""
    board = [[0.0, -1, 0.5], [1.5, -1, 0.5], [1.5, 1, 0.5], [0.0, 1, 0.5]]
    places = ([0.002, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.5, 0.0, 0.0])
    edge, lit, shadow = (errors([board], 1.0, np.array([place]), 0.01)[0] for place in places)
    assert edge > 5.0 * lit > 0.0
    assert shadow == 0.0
    assert errors([], 1.0, np.array([[0.3, 0.0, 2.0]]), 0.01)[0] == 0.0  # above a lamp that shines down


def test_lamps_that_few_pixels_see_alone_are_doubted_by_the_spread_of_their_radiance() -> None:
    room = make_room([FLOOR, lamp_above(0.5), lamp_above(1.0)])
    triangle = np.array([2] * 20 + [4] * 12)
    own = np.full((32, 3), 100.0, np.float32)
    own[20:26] *= 1.5
    pixels = SimpleNamespace(triangle=triangle, own=own, weight=np.full(32, 0.5), pure=np.arange(32) < 22, radiance=own)
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
