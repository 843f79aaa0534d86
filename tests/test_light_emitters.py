# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters: grouped into fixtures, measured by the pixels that see them."""

import itertools

import numpy as np
import pytest

from fipt_blender.core.light.emitters import (
    ALIKE,
    EmitterPixels,
    bright_triangles,
    emitter_components,
    emitter_table,
    group_fixtures,
    side_medians,
)
from samples.small_rooms import BOX, make_room, room_with_bulb


def pixels(rows: list[tuple[int, bool, float, float]]) -> EmitterPixels:
    """Pixels of (triangle, front, weight, grey) rows."""
    triangle, front, weight, grey = (np.array(column) for column in zip(*rows, strict=True))
    return EmitterPixels(triangle, front.astype(bool), np.repeat(grey[:, None], 3, axis=1), weight.astype(float))


def test_weighted_medians_of_both_sides() -> None:
    group = np.array([0, 0, 1, -1])
    rows = [(0, True, 1.0, 4.0), (0, True, 1.0, 6.0), (1, True, 1.0, 9.0), (1, True, 0.1, 100.0)]
    rows += [(0, False, 1.0, 1.0), (2, True, 0.1, 3.0), (3, True, 1.0, 50.0), (-1, True, 1.0, 70.0)]
    medians, weights = side_medians(pixels(rows), group)
    assert medians[:, :, 0].tolist() == [[6.0, 1.0], [3.0, 0.0]]
    np.testing.assert_allclose(weights, [[3.1, 1.0], [0.1, 0.0]])
    medians, _ = side_medians(pixels(rows), np.full(4, -1))
    assert len(medians) == 0


def test_two_lamps_apart_are_two_fixtures_with_their_sides() -> None:
    """A panel lit below, and a smaller two-sided one; the dim back of the first counts as dark."""
    first = [[-1.5, -1, 2.9], [-1.5, 0, 2.9], [-0.5, 0, 2.9], [-0.5, -1, 2.9]]
    second = [[0.5, 0, 2.0], [0.5, 0.5, 2.0], [1.0, 0.5, 2.0], [1.0, 0, 2.0]]
    room = make_room([*BOX, first, second])
    emitting = np.zeros(16, bool)
    emitting[12:] = True
    rows = [(12, True, 1.0, 10.0), (13, True, 1.0, 10.5), (12, False, 1.0, 0.4)]
    rows += [(14, True, 1.0, 4.0), (15, True, 1.0, 4.2), (14, False, 1.0, 3.0), (0, True, 1.0, 0.5)]
    fixtures = group_fixtures(room, emitting, pixels(rows))
    assert [fixture.triangles.tolist() for fixture in fixtures] == [[12, 13], [14, 15]]
    assert fixtures[0].radiance[0] == pytest.approx(10.0) and fixtures[0].back_radiance[0] == 0.0
    assert fixtures[1].radiance[0] == pytest.approx(4.0) and fixtures[1].back_radiance[0] == 3.0
    assert fixtures[0].area == pytest.approx(1.0) and fixtures[1].area == pytest.approx(0.25)
    assert fixtures[0].centroid == pytest.approx([-1.0, -0.5, 2.9])
    table = emitter_table(fixtures)
    assert table.triangles.tolist() == [12, 13, 14, 15]
    assert table.radiance[:, 1].tolist() == pytest.approx([10.0, 10.0, 4.0, 4.0])
    assert table.back_radiance[:, 2].tolist() == [0.0, 0.0, 3.0, 3.0]
    assert len(emitter_table([]).triangles) == 0
    assert group_fixtures(room, np.zeros(16, bool), pixels(rows)) == []


def test_touching_triangles_of_unlike_radiance_are_two_fixtures() -> None:
    room = make_room([*BOX, [[0, 0, 2], [0, 1, 2], [1, 1, 2], [1, 0, 2]]])
    emitting = np.zeros(14, bool)
    emitting[12:] = True
    for other, number in ((1.3, 1), (3.0, 2)):
        rows = [(12, True, 1.0, 1.0), (13, True, 1.0, other)]
        assert len(group_fixtures(room, emitting, pixels(rows))) == number


def test_unseen_triangles_are_as_bright_as_their_lamp_and_black_ones_are_no_lamp() -> None:
    room = room_with_bulb(0.05)
    emitting = np.arange(20) >= 12
    rows = [(i, True, 1.0, 8.0) for i in (12, 13, 14)] + [(2, True, 1.0, 0.3)]
    fixtures = group_fixtures(room, emitting, pixels(rows))
    assert [fixture.triangles.tolist() for fixture in fixtures] == [list(range(12, 20))]
    black = [(i, True, 1.0, 0.0) for i in (12, 13, 14)]
    assert group_fixtures(room, emitting, pixels(black)) == []


def test_the_far_side_of_a_bulb_in_mixed_pixels_alone_is_the_bulb() -> None:
    """Pixels at its outline show mostly what is behind; the sides seen alone tell how bright it is."""
    room = room_with_bulb(0.05)
    emitting = np.arange(20) >= 12
    rows = [(i, True, 1.0, 8.0) for i in (12, 13, 14)] + [(2, True, 1.0, 0.3)]
    rows += [(i, True, 0.1, 0.6) for i in (15, 16, 17, 18)]
    (fixture,) = group_fixtures(room, emitting, pixels(rows))
    assert fixture.triangles.tolist() == list(range(12, 20))
    assert fixture.radiance.tolist() == [8.0] * 3


def test_bright_triangles_are_aimed_at() -> None:
    room = make_room([*BOX, [[0, 0, 2.9], [0, 0.4, 2.9], [0.4, 0.4, 2.9], [0.4, 0, 2.9]]])
    rows = [(i, True, 1.0, 0.5) for i in range(12)] + [(12, True, 1.0, 60.0), (13, False, 1.0, 40.0)]
    seen = pixels(rows)
    table = bright_triangles(room, seen.triangle, seen.front, seen.radiance)
    assert table.triangles.tolist() == [12, 13]
    assert table.radiance[:, 0].tolist() == [60.0, 0.0] and table.back_radiance[:, 0].tolist() == [0.0, 40.0]
    assert len(bright_triangles(room, seen.triangle, seen.front, seen.radiance * 0.0).triangles) == 0


@pytest.mark.parametrize("unseen", [0, 3])
def test_fixtures_do_not_depend_on_the_order_of_triangles(unseen: int, rng: np.random.Generator) -> None:
    """Triangles of two luminances, and some without pixels, alternate around vertices."""
    luminance, seen = np.array([1.0, 10.0, 1.0, 10.0]), np.ones(4, bool)
    fan = np.array([[0, 1, 2], [0, 3, 4], [0, 5, 6], [0, 7, 8]])
    for order in itertools.permutations(range(4)):
        group = emitter_components(fan, luminance[list(order)], seen)
        assert len(np.unique(group)) == 2, order
        assert len(np.unique(group[np.argsort(order)][:2])) == 2
    corners = rng.integers(0, 40, (60, 3))
    luminance = np.exp(rng.normal(size=60))
    seen = np.arange(60) >= unseen
    group = emitter_components(corners, luminance, seen)
    # Two triangles are of one group exactly if a path of pairs leads from one to the other.
    shared = (corners[:, None, :, None] == corners[None, :, None, :]).any(axis=(2, 3))
    ratio = np.maximum(luminance[:, None] / luminance, luminance / luminance[:, None])
    linked = shared & ((ratio <= ALIKE) | ~(seen[:, None] & seen))
    for _ in range(6):
        linked = (linked.astype(int) @ linked) > 0
    np.testing.assert_array_equal(group[:, None] == group, linked)
    assert 1 < len(np.unique(group)) < 60
    for _ in range(20):
        order = rng.permutation(60)
        other = emitter_components(rng.permuted(corners[order], axis=1), luminance[order], seen[order])
        np.testing.assert_array_equal(other[:, None] == other, linked[order][:, order])
