# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped lamps: their radiance, and the contrast of the response, from the light on other surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.light.clipped import ON_LAMP, OUTSIDE, Expectation, LitPoints, light_on_points, solve_lamps
from samples.shading_points import grid_of
from samples.small_rooms import BOX, make_room

PANEL = [[-0.5, -0.5, 2.9], [-0.5, 0.5, 2.9], [0.5, 0.5, 2.9], [0.5, -0.5, 2.9]]
UP = np.array([[0.0, 0.0, 1.0]])


def lamp_of(room, quads):
    """The triangles of each of these quadrilaterals are one lamp."""
    lamp = np.full(len(room.triangles), -1, np.int32)
    for index, quad in enumerate(quads):
        lamp[2 * quad : 2 * quad + 2] = index
    return lamp


def synthetic(contrast: float, seed: int = 0):
    """Points of eight parts that two lamps light, with textures and a tenth of glossy points."""
    rng = np.random.default_rng(seed)
    count, entries = 2500, 400
    cache = rng.normal(-1.0, 0.7, (entries, 3))
    # Rays of one point meet what lies near it: the indirect light varies, too.
    entry = rng.integers(0, 20, (count, 1)) * 20 + rng.integers(0, 20, (count, 32))
    direct = np.stack([np.exp(rng.normal(-4.0, 1.2, count)), np.exp(rng.normal(-5.0, 1.0, count))], axis=1)
    direct = np.concatenate([direct, np.zeros((count, 1))], axis=1)
    radiance = np.array([[60.0, 50.0, 40.0], [200.0, 150.0, 90.0], [1.0, 1.0, 1.0]])
    part = rng.integers(0, 8, count)
    albedo = rng.uniform(0.1, 0.8, (8, 3))[part] * np.exp(rng.normal(0.0, 0.1, (count, 1)))
    light = np.exp(cache)[entry].mean(axis=1) + direct @ radiance
    value = np.log(albedo * light * np.where(rng.random((count, 1)) < 0.1, 2.0, 1.0)) / contrast
    value[rng.random(value.shape) < 0.05] = np.nan
    points = LitPoints(value, part, entry, direct)
    return points, cache / contrast, np.full((3, 3), np.log(4.0) / contrast), radiance


@pytest.mark.parametrize("contrast", [2.3, 3.2])
def test_lamps_and_contrast_come_back(contrast):
    points, cache, bound, radiance = synthetic(contrast)
    found = solve_lamps(points, cache, Expectation.of(bound, np.log(2.8)), (np.log(2.8), 1.0))
    assert found.log_contrast[0] == pytest.approx(np.log(contrast), abs=0.03)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.1
    assert found.deviation[:2].max() < 0.15 and found.spread * contrast < 0.2


def test_a_known_error_of_the_model_is_corrected():
    """Light that varies more than the model says: without the correction, the contrast is wrong."""
    contrast = 2.6
    points, cache, bound, radiance = synthetic(contrast)
    light = points.light(cache, radiance, contrast)
    correction = 0.2 * np.log(light)
    points = replace(points, value=points.value + correction / contrast, correction=correction)
    expected = Expectation.of(bound, np.log(2.8))
    found = solve_lamps(points, cache, expected, (np.log(2.8), 1.0))
    assert found.log_contrast[0] == pytest.approx(np.log(contrast), abs=0.03)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.1
    wrong = solve_lamps(replace(points, correction=0.0), cache, expected, (np.log(2.8), 1.0))
    assert abs(wrong.log_contrast[0] - np.log(contrast)) > 0.05


def test_a_known_contrast_is_kept_and_a_lamp_that_lights_nothing_is_said_to_be_unknown():
    """Unless it is known from elsewhere: nothing looks outside, which is the third lamp."""
    points, cache, bound, radiance = synthetic(2.6)
    broad = Expectation.of(bound, np.log(2.6))
    found = solve_lamps(points, cache, broad, (np.log(2.6), 0.0))
    assert found.log_contrast[0] == pytest.approx(np.log(2.6), abs=1e-3)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.06
    assert found.deviation[2].min() > 1.5 and np.abs(found.log_radiance[2] - np.log(8.0 * 4.0)).max() < 1e-3
    known = replace(broad, log_radiance=np.full((3, 3), 1.5), deviation=np.array([2.0, 2.0, 0.1]))
    found = solve_lamps(points, cache, known, (np.log(2.6), 0.0))
    assert np.abs(found.log_radiance[2] - 1.5).max() < 1e-3 and found.deviation[2].max() < 0.11


def test_direct_light_of_a_panel_over_the_floor():
    """The analytic irradiance of a small horizontal square: A cos² / (pi d²)."""
    small = [[0.1 * x, 0.1 * y, z] for x, y, z in PANEL]
    room = make_room([*BOX, small])
    lamp = lamp_of(room, [6])
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    entry, direct = light_on_points(room, grid_of(room), (position, np.repeat(UP, 2, 0)), lamp, 0)
    squared = np.array([2.9**2, 2.9**2 + 1.0])
    expected = 0.01 * (2.9**2 / squared) / (np.pi * squared)
    assert direct[:, 0] == pytest.approx(expected, rel=0.01) and direct[:, 1].max() == 0.0
    assert (entry >= 0).mean() > 0.95


def test_light_from_all_around_is_one():
    """Where every surface is one lamp, or there is nothing, all light is its radiance."""
    room = make_room(BOX)
    every = np.zeros(len(room.triangles), np.int32)
    point = (np.array([[0.1, 0.2, 1e-3]]), UP)
    entry, _ = light_on_points(room, grid_of(room), point, every, 0)
    assert (entry == ON_LAMP).all()
    floor = make_room(BOX[:1])
    entry, direct = light_on_points(floor, grid_of(floor), point, np.full(2, -1, np.int32), 0)
    assert (entry == OUTSIDE).all() and direct.tolist() == [[1.0]]


def test_a_screen_casts_a_shadow():
    screen = [[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]
    room = make_room([*BOX, PANEL, screen])
    _, direct = light_on_points(room, grid_of(room), (np.array([[0.0, 0.0, 0.0]]), UP), lamp_of(room, [6]), 0)
    assert direct.max() == 0.0
