# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps of a scan: what emits as a whole, specks, sides that shine."""

import numpy as np

from fipt_blender.core.light.emitter_surfaces import emitter_surfaces
from fipt_blender.core.light.emitters import EmitterPixels, group_fixtures
from fipt_blender.core.light.scan_fixtures import scan_groups, seen_sides
from fipt_blender.core.parts.labels import NO_PART, Parts
from fipt_blender.core.surface.room import Room
from samples.scans import scanned_box
from samples.small_rooms import BOX, make_room

ROOM, SIDE = scanned_box(noise=0.002)
CEILING = 1


def in_square(room: Room, side: int, low: float, high: float) -> np.ndarray:
    """(T,) bool, triangles of a side of the box within a square of x and y."""
    assert room.scan is not None
    inside = (room.scan.centers[:, :2] > low).all(axis=1) & (room.scan.centers[:, :2] < high).all(axis=1)
    return np.asarray((SIDE == side) & inside)


def seen(triangles: np.ndarray, luminance: np.ndarray | float, front: bool = True) -> EmitterPixels:
    """A pixel on each triangle."""
    radiance = np.broadcast_to(np.asarray(luminance, np.float32).reshape(-1, 1), (len(triangles), 3))
    count = len(triangles)
    return EmitterPixels(triangles, np.full(count, front), np.array(radiance), np.ones(count, np.float32))


def joined(*pixels: EmitterPixels) -> EmitterPixels:
    names = ("triangle", "front", "radiance", "weight")
    return EmitterPixels(*(np.concatenate([getattr(each, name) for each in pixels]) for name in names))


def test_a_modelled_room_emits_triangle_by_triangle() -> None:
    room = make_room(BOX)
    none = Parts(np.full(12, NO_PART, np.int32), "none")
    surfaces = emitter_surfaces(room, none, 0.01)
    assert np.array_equal(surfaces.unit, np.arange(12)) and surfaces.unseen == 0.0
    assert len(np.unique(surfaces.component)) == 6


def test_unjudged_triangles_of_a_modelled_room_follow_those_of_their_part() -> None:
    room = make_room(BOX)
    whole = emitter_surfaces(room, Parts(np.full(12, NO_PART, np.int32), "none"), 0.01).component
    part = np.arange(12, dtype=np.int32) % 2  # the two triangles of a side
    divided = emitter_surfaces(room, Parts(part, "part"), 0.01).component
    assert len(np.unique(divided)) == 2 * len(np.unique(whole))


def test_a_scan_emits_by_parts_and_without_them_by_patches() -> None:
    part = np.where(in_square(ROOM, CEILING, -0.5, 0.5), 3, SIDE % 2).astype(np.int32)
    part[SIDE == 5] = NO_PART
    surfaces = emitter_surfaces(ROOM, Parts(part, "part"), 0.1)
    known = part >= 0
    pairs = np.unique(np.column_stack([surfaces.unit[known], part[known]]), axis=0)
    assert len(pairs) == len(np.unique(part[known]))
    assert not np.isin(surfaces.unit[~known], surfaces.unit[known]).any()
    assert surfaces.gap > 0.2
    patches = emitter_surfaces(ROOM, Parts(np.full(len(part), NO_PART, np.int32), "none"), 0.1)
    assert ROOM.scan is not None
    for unit in np.unique(patches.unit)[::50]:
        members = ROOM.scan.centers[patches.unit == unit]
        assert np.ptp(members, axis=0).max() <= 0.2 and len(np.unique(SIDE[patches.unit == unit])) == 1


def test_specks_near_a_lamp_are_part_of_it_and_others_are_none() -> None:
    assert ROOM.scan is not None
    lamp = in_square(ROOM, CEILING, -0.6, 0.6)
    distance = np.linalg.norm(ROOM.scan.centers - [0.9, 0.0, 3.0], axis=1)
    near = np.zeros_like(lamp)
    near[distance.argmin()] = True
    far = np.zeros_like(lamp)
    far[np.linalg.norm(ROOM.scan.centers - [-1.8, -1.8, 0.0], axis=1).argmin()] = True
    ids = np.flatnonzero(lamp | near | far)
    group = scan_groups(ROOM.scan, ids, None)
    assert (group[lamp[ids]] == 0).all() and (group[near[ids]] == 0).all() and (group[far[ids]] == -1).all()
    small = np.linalg.norm(ROOM.scan.centers - [-1.5, -1.5, 0.0], axis=1) < 0.3
    group = scan_groups(ROOM.scan, np.flatnonzero(lamp | small), None)
    assert sorted(np.bincount(group)) == sorted([lamp.sum(), small.sum()])  # a small lamp far from the large one
    apart = scan_groups(ROOM.scan, ids, np.where(near, 1, 0))
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
    assert ROOM.scan is not None
    lamp = np.flatnonzero(in_square(ROOM, CEILING, -0.8, 0.8))
    rim = np.abs(ROOM.scan.centers[lamp, :2]).max(axis=1) > 0.7
    emitting = np.zeros(len(SIDE), bool)
    emitting[lamp] = True
    pixels = joined(seen(lamp, np.where(rim, 30.0, 100.0)), seen(lamp[rim][:20], 50.0, front=False))
    (fixture,) = group_fixtures(ROOM, emitting, pixels)
    assert np.array_equal(fixture.triangles, lamp)
    assert np.allclose(fixture.radiance, 100.0) and not fixture.back_radiance.any()
    both = joined(seen(lamp, 100.0), seen(lamp, 50.0, front=False))
    (fixture,) = group_fixtures(ROOM, emitting, both)
    assert np.allclose(fixture.back_radiance, 50.0)
