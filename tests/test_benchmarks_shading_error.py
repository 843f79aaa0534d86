# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark of shadings: its truth in closed cases, its texture lookup, its error measure."""

import numpy as np
import pytest

from benchmarks import shading_error
from benchmarks.tracer.forward import LitRoom
from benchmarks.tracer.surfaces import LatticeMaterials
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, bake
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.surface.room import Room
from samples.small_rooms import BOX, make_room

ALBEDO = 0.5


def box() -> Room:
    """The unit cube seen from inside; triangles 0 and 1 are its ceiling."""
    quads = (np.array(BOX) + [2, 2, 0]) / [4, 4, 3]
    return make_room(quads[[1, 0, 2, 3, 4, 5]])


def lit_box(emitting: list[int], radiance: float) -> LitRoom:
    room = box()
    front = np.full((len(emitting), 3), radiance, np.float32)
    lights = AreaLights(
        room.vertices, room.triangles, EmitterTable(np.array(emitting, np.int32), front, 0.0 * front)
    )

    def query(positions, triangles):
        count = len(positions)
        return (
            np.full((count, 3), ALBEDO, np.float32),
            np.ones(count, np.float32),
            np.zeros(count, np.float32),
        )

    return LitRoom(room, LatticeMaterials(room, query, 0.5), lights)


def diffuse_shading(lit: LitRoom, count: int) -> np.ndarray:
    """L_d of points spread over the floor."""
    position = np.column_stack([np.random.default_rng(0).random((count, 2)), np.zeros(count)]).astype(
        np.float32
    )
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (count, 1))
    points = ShadingPoints(position, up, up, up)
    source = shading_error.PathTraced(lit)
    return bake(points, source, lit.lights, np.array([0.5], np.float32), SampleCounts(64, 8, 64), 3).diffuse


def test_inside_a_box_that_glows_everywhere_shading_is_its_radiance():
    shaded = diffuse_shading(lit_box(list(range(12)), 2.0), 64)
    np.testing.assert_allclose(shaded.mean(axis=0), 2.0, rtol=0.03)


def test_interreflections_are_in_the_truth():
    """Light between floor and glowing ceiling of a cube, against radiosity with its known form factors."""
    shaded = diffuse_shading(lit_box([0, 1], 1.0), 4096)
    opposite = 0.1998  # form factor of opposite faces of a cube (any heat-transfer catalogue)
    beside = (1.0 - opposite) / 4.0
    # Irradiance / pi of floor f and of each wall w: reflected radiance is kd times it. The rough dielectric
    # also reflects a little specularly, which keeps this an approximation.
    matrix = np.array(
        [[1.0, -4.0 * beside * ALBEDO], [-beside * ALBEDO, 1.0 - ALBEDO * (2.0 * beside + opposite)]]
    )
    floor, _ = np.linalg.solve(matrix, [opposite, beside])
    direct = opposite
    assert floor > 1.4 * direct
    np.testing.assert_allclose(shaded.mean(), floor, rtol=0.08)


def test_textures_tile_and_v_points_up():
    image = np.arange(6, dtype=np.float32).reshape(2, 3, 1).repeat(3, axis=2)
    uv = np.array([[0.1, 0.9], [0.9, 0.1], [1.1, 1.9], [-0.1, 0.9]])
    np.testing.assert_array_equal(shading_error.sample(image, uv)[:, 0], [0.0, 5.0, 0.0, 2.0])


def test_the_error_is_relative_on_display_values():
    truth = np.full((10, 3), 0.25, np.float32)
    assert shading_error.relative_rmse(truth, truth) == 0.0
    assert shading_error.relative_rmse(np.zeros_like(truth), truth) == pytest.approx(1.0)
    assert shading_error.relative_rmse(truth * 1.1**2.2, truth) == pytest.approx(0.1, rel=1e-5)
    assert shading_error.relative_rmse(truth * 0.0 + 7.0, truth * 0.0 + 3.0) == 0.0  # both overexposed
