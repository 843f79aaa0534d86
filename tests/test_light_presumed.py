# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Presumed lamps of stage 1: complete, constant, and read instead of the cache."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.light.cache import SurfaceLookup
from fipt_blender.core.light.emitters import EmitterPixels, bright_triangles
from fipt_blender.core.light.presumed import presume_lamps
from fipt_blender.core.light.radiance import CachedRadiance, new_path
from fipt_blender.core.optics.lights import AreaLights
from fipt_blender.core.surface.room import Room
from samples.shading_points import grid_of
from samples.small_rooms import room_with_bulb


def pixels(radiance: dict[int, list[float]]) -> EmitterPixels:
    """Pure pixels of grey radiances on the fronts of triangles."""
    triangle = np.concatenate([np.full(len(values), index) for index, values in radiance.items()])
    grey = np.concatenate([np.array(values, np.float32) for values in radiance.values()])
    return EmitterPixels(
        triangle, np.ones(len(grey), bool), np.tile(grey[:, None], (1, 3)), np.ones(len(grey), np.float32)
    )


def presumed(room: Room, seen: EmitterPixels) -> tuple:
    bright = bright_triangles(room, seen.triangle, seen.front, seen.radiance)
    return bright, *presume_lamps(room, seen, bright)


def test_unseen_sides_of_a_lamp_shine_too() -> None:
    room = room_with_bulb(0.1)
    walls = {index: [0.5, 0.6] for index in range(12)}
    _, table, lamps = presumed(room, pixels(walls | {12: [60.0, 61.0, 59.0], 13: [60.0, 60.0]}))
    assert np.flatnonzero(lamps).tolist() == list(range(12, 20))
    assert sorted(table.triangles.tolist()) == list(range(12, 20)) and not table.reflective_mask().any()
    assert table.radiance == pytest.approx(60.0)


@pytest.mark.parametrize("varies", [True, False])
def test_lit_surfaces_and_single_pixels_are_no_lamps(varies: bool) -> None:
    """They are aimed at, and their radiance stays in the cache."""
    room = room_with_bulb(0.1)
    walls = {index: [0.5, 0.6] for index in range(12)}
    on_bulb = {12: [20.0, 30.0, 40.0, 50.0, 60.0, 70.0]} if varies else {12: [60.0, 60.0]}
    bright, table, lamps = presumed(room, pixels(walls | on_bulb))
    assert not lamps.any()
    assert table.triangles.tolist() == bright.triangles.tolist() and table.reflective_mask().all()


def test_nothing_bright() -> None:
    room = room_with_bulb(0.1)
    bright, table, lamps = presumed(room, pixels({index: [0.0] for index in range(12)}))
    assert table is bright and not lamps.any()


def test_stage_1_reads_lamps_from_the_table_and_all_else_from_the_cache() -> None:
    room = room_with_bulb(0.1)
    walls = {index: [0.5] * 6 for index in range(12)}
    _, table, _ = presumed(room, pixels(walls | {12: [60.0] * 6, 11: [40.0, 90.0]}))
    assert table.reflective_mask().sum() == 1  # a bright spot of a wall
    grid = grid_of(room)
    cache = SurfaceLookup(grid, np.full((len(grid.voxels) * 6, 3), 0.25, np.float32))
    source = CachedRadiance(room, cache, None, AreaLights(room.vertices, room.triangles, table))
    ray = mi.Ray3f(mi.Point3f([0.5, -1.0], [0.3, -1.0], [2.9, 2.9]), mi.Vector3f(0.0, 0.0, -1.0))
    path, _, _ = source.step(new_path(2), ray.d, source.intersect(ray, mi.Bool(True)), mi.PCG32(2), dr.ones(mi.Bool, 2))
    assert np.array(path.radiance)[0].tolist() == pytest.approx([60.0, 0.25])
