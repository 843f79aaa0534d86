# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Emitters: grouped into fixtures, measured by the pixels that see them, of a scan as a whole; presumed lamps."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.light.cache import SurfaceLookup
from fipt_blender.core.light.emitter_surfaces import emitter_surfaces
from fipt_blender.core.light.emitters import (
    ALIKE,
    EmitterPixels,
    bright_triangles,
    emitter_components,
    emitter_table,
    group_fixtures,
    side_medians,
)
from fipt_blender.core.light.presumed import presume_lamps
from fipt_blender.core.light.radiance import CachedRadiance, new_path
from fipt_blender.core.light.scan_fixtures import scan_groups, seen_sides
from fipt_blender.core.optics.lights import AreaLights
from fipt_blender.core.parts.labels import NO_PART, Parts
from fipt_blender.core.surface.room import Room
from samples.scans import scanned_box
from samples.shading_points import grid_of
from samples.small_rooms import BOX, make_room, room_with_bulb

SCAN, SIDE = scanned_box(noise=0.002)
assert SCAN.scan is not None
CENTERS = SCAN.scan.centers
CEILING = 1


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
    """Pixels at its outline show mostly what is behind; the sides seen alone tell how bright it is."""
    room = room_with_bulb(0.05)
    emitting = np.arange(20) >= 12
    alone = [(i, True, 1.0, 8.0) for i in (12, 13, 14)] + [(2, True, 1.0, 0.3)]
    for mixed in ([], [(i, True, 0.1, 0.6) for i in (15, 16, 17, 18)]):
        (fixture,) = group_fixtures(room, emitting, pixels(alone + mixed))
        assert fixture.triangles.tolist() == list(range(12, 20)) and fixture.radiance.tolist() == [8.0] * 3
    assert group_fixtures(room, emitting, pixels([(i, True, 1.0, 0.0) for i in (12, 13, 14)])) == []


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
    """Some have no pixels."""
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


def in_square(side: int, half: float) -> np.ndarray:
    """(T,) bool, triangles of a side of the scanned box within a square of x and y."""
    return np.asarray((SIDE == side) & (np.abs(CENTERS[:, :2]) < half).all(axis=1))


def seen(triangles: np.ndarray, grey: np.ndarray | float, front: bool = True) -> list[tuple[int, bool, float, float]]:
    """Rows of a pixel on each triangle."""
    return [(t, front, 1.0, g) for t, g in zip(triangles, np.broadcast_to(grey, len(triangles)), strict=True)]


def test_a_modelled_room_emits_triangle_by_triangle_and_unjudged_ones_follow_their_part() -> None:
    room = make_room(BOX)
    surfaces = emitter_surfaces(room, Parts(np.full(12, NO_PART, np.int32), "none"), 0.01)
    assert np.array_equal(surfaces.unit, np.arange(12)) and surfaces.unseen == 0.0
    assert len(np.unique(surfaces.component)) == 6
    part = np.arange(12, dtype=np.int32) % 2  # the two triangles of a side
    assert len(np.unique(emitter_surfaces(room, Parts(part, "part"), 0.01).component)) == 12


def test_a_scan_emits_by_parts_and_without_them_by_patches() -> None:
    part = np.where(in_square(CEILING, 0.5), 3, SIDE % 2).astype(np.int32)
    part[SIDE == 5] = NO_PART
    surfaces = emitter_surfaces(SCAN, Parts(part, "part"), 0.1)
    known = part >= 0
    pairs = np.unique(np.column_stack([surfaces.unit[known], part[known]]), axis=0)
    assert len(pairs) == len(np.unique(part[known]))
    assert not np.isin(surfaces.unit[~known], surfaces.unit[known]).any()
    assert surfaces.gap > 0.2
    patches = emitter_surfaces(SCAN, Parts(np.full(len(part), NO_PART, np.int32), "none"), 0.1)
    for unit in np.unique(patches.unit)[::50]:
        members = CENTERS[patches.unit == unit]
        assert np.ptp(members, axis=0).max() <= 0.2 and len(np.unique(SIDE[patches.unit == unit])) == 1


def test_specks_near_a_lamp_are_part_of_it_and_others_are_none() -> None:
    lamp = in_square(CEILING, 0.6)
    distance = np.linalg.norm(CENTERS - [0.9, 0.0, 3.0], axis=1)
    near = np.zeros_like(lamp)
    near[distance.argmin()] = True
    far = np.zeros_like(lamp)
    far[np.linalg.norm(CENTERS - [-1.8, -1.8, 0.0], axis=1).argmin()] = True
    ids = np.flatnonzero(lamp | near | far)
    group = scan_groups(SCAN.scan, ids, None)
    assert (group[lamp[ids]] == 0).all() and (group[near[ids]] == 0).all() and (group[far[ids]] == -1).all()
    small = np.linalg.norm(CENTERS - [-1.5, -1.5, 0.0], axis=1) < 0.3
    group = scan_groups(SCAN.scan, np.flatnonzero(lamp | small), None)
    assert sorted(np.bincount(group)) == sorted([lamp.sum(), small.sum()])  # a small lamp far from the large one
    apart = scan_groups(SCAN.scan, ids, np.where(near, 1, 0))
    assert (apart[near[ids]] == -1).all()  # the speck is of another part


def test_a_side_shines_only_if_much_of_it_is_seen() -> None:
    areas, fixture = np.ones(10), np.zeros(10, np.int64)
    seen_front, seen_back = np.ones(10, bool), np.arange(10) < 2
    assert seen_sides(areas, np.column_stack([seen_front, seen_back]), fixture).tolist() == [[True, False]]
    assert seen_sides(areas, np.ones((10, 2), bool), fixture).tolist() == [[True, True]]
    unseen = seen_sides(areas, np.zeros((10, 2), bool), np.full(10, -1))
    assert unseen.shape == (0, 2)


def test_fixtures_of_a_scan_are_whole_and_have_one_side() -> None:
    """The rim is darker, pixels at the rim see the back, and the wall beside the lamp is lit by it."""
    lamp = np.flatnonzero(in_square(CEILING, 0.8))
    rim = np.abs(CENTERS[lamp, :2]).max(axis=1) > 0.7
    emitting = np.zeros(len(SIDE), bool)
    emitting[lamp] = True
    rows = seen(lamp, np.where(rim, 30.0, 100.0)) + seen(lamp[rim][:20], 50.0, front=False)
    (fixture,) = group_fixtures(SCAN, emitting, pixels(rows))
    assert np.array_equal(fixture.triangles, lamp)
    assert np.allclose(fixture.radiance, 100.0) and not fixture.back_radiance.any()
    both = pixels(seen(lamp, 100.0) + seen(lamp, 50.0, front=False))
    (fixture,) = group_fixtures(SCAN, emitting, both)
    assert np.allclose(fixture.back_radiance, 50.0)


def presumed(room: Room, radiance: dict[int, list[float]]) -> tuple:
    """Bright triangles, table and lamps, of pure pixels of grey radiances on the fronts of triangles."""
    seen = pixels([(index, True, 1.0, grey) for index, values in radiance.items() for grey in values])
    bright = bright_triangles(room, seen.triangle, seen.front, seen.radiance)
    return bright, *presume_lamps(room, seen, bright)


def test_unseen_sides_of_a_lamp_shine_too() -> None:
    room = room_with_bulb(0.1)
    walls = {index: [0.5, 0.6] for index in range(12)}
    _, table, lamps = presumed(room, walls | {12: [60.0, 61.0, 59.0], 13: [60.0, 60.0]})
    assert np.flatnonzero(lamps).tolist() == list(range(12, 20))
    assert sorted(table.triangles.tolist()) == list(range(12, 20)) and not table.reflective_mask().any()
    assert table.radiance == pytest.approx(60.0)


@pytest.mark.parametrize("varies", [True, False])
def test_lit_surfaces_and_single_pixels_are_no_lamps(varies: bool) -> None:
    """They are aimed at, and their radiance stays in the cache."""
    room = room_with_bulb(0.1)
    walls = {index: [0.5, 0.6] for index in range(12)}
    on_bulb = {12: [20.0, 30.0, 40.0, 50.0, 60.0, 70.0]} if varies else {12: [60.0, 60.0]}
    bright, table, lamps = presumed(room, walls | on_bulb)
    assert not lamps.any()
    assert table.triangles.tolist() == bright.triangles.tolist() and table.reflective_mask().all()
    bright, table, lamps = presumed(room, {index: [0.0] for index in range(12)})
    assert table is bright and not lamps.any()


def test_stage_1_reads_lamps_from_the_table_and_all_else_from_the_cache() -> None:
    room = room_with_bulb(0.1)
    walls = {index: [0.5] * 6 for index in range(12)}
    _, table, _ = presumed(room, walls | {12: [60.0] * 6, 11: [40.0, 90.0]})
    assert table.reflective_mask().sum() == 1  # a bright spot of a wall
    grid = grid_of(room)
    cache = SurfaceLookup(grid, np.full((len(grid.voxels) * 6, 3), 0.25, np.float32))
    source = CachedRadiance(room, cache, None, AreaLights(room.vertices, room.triangles, table))
    ray = mi.Ray3f(mi.Point3f([0.5, -1.0], [0.3, -1.0], [2.9, 2.9]), mi.Vector3f(0.0, 0.0, -1.0))
    path, _, _ = source.step(new_path(2), ray.d, source.intersect(ray, mi.Bool(True)), mi.PCG32(2), dr.ones(mi.Bool, 2))
    assert np.array(path.radiance)[0].tolist() == pytest.approx([60.0, 0.25])
