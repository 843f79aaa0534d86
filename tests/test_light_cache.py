# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance cache: exact means, sides that do not mix, holes filled, the same entries on both engines."""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from fipt_blender.core.light.cache import SIDES, SurfaceLookup, pool, side_index
from fipt_blender.core.light.observations import observe
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, WALL_RADIANCE, make_pixels
from samples.shading_points import make_grid
from samples.small_rooms import BOX, make_room, surface_points

SHELF = [[-1.0, 0.3, 1.0], [1.0, 0.3, 1.0], [1.2, 0.9, 1.7], [-0.8, 0.9, 1.7]]


def filled_grid(room, resolution: int = 32):
    rng = np.random.default_rng(0)
    points, normals, triangle = surface_points(room, 3000, rng)
    return make_grid(room, points, normals, resolution, rng), points, normals, triangle


def test_pooling_is_the_mean_of_each_entry(rng: np.random.Generator) -> None:
    grid, points, normals, _ = filled_grid(make_room([*BOX, SHELF]))
    entries = grid.entries(points, normals)
    values = rng.normal(size=(len(points), 3))
    mean, count = pool(grid, entries, values)
    assert len(mean) == len(grid.voxels) * SIDES and count.sum() == len(points)
    for entry in rng.choice(entries, 50):
        inside = entries == entry
        assert count[entry] == inside.sum()
        np.testing.assert_allclose(mean[entry], values[inside].mean(axis=0), rtol=1e-5, atol=1e-6)


def test_two_sides_of_a_thin_wall_do_not_mix() -> None:
    """A single sheet, and two sheets a millimetre apart in voxels of 13 cm: each side keeps its value."""
    sheet = [[-1, 0, 0], [1, 0, 0], [1, 0, 2], [-1, 0, 2]]
    second = [[-1, 0.001, 0], [-1, 0.001, 2], [1, 0.001, 2], [1, 0.001, 0]]
    for quads in ([*BOX, sheet], [*BOX, sheet, second]):
        room = make_room(quads)
        grid, *_ = filled_grid(room)
        points, normals, _ = surface_points(room, 500, np.random.default_rng(1), np.array([12, 13]))
        entries = np.concatenate([grid.entries(points, normals), grid.entries(points, -normals)])
        values = np.repeat([[10.0], [0.0]], len(points), axis=0)
        mean, _ = pool(grid, entries, values)
        assert (mean[entries[: len(points)]] == 10.0).all() and (mean[entries[len(points) :]] == 0.0).all()


def test_unseen_surfaces_take_near_values_and_are_not_black() -> None:
    """Only x < 0 of the floor is photographed; its radiance grows with y."""
    room = make_room(BOX)
    grid, *_ = filled_grid(room, 40)
    points, normals, _ = surface_points(room, 20_000, np.random.default_rng(1), np.array([0, 1]))
    seen = points[:, 0] < 0
    value = 3.0 + points[:, 1:2]
    mean, _ = pool(grid, grid.entries(points[seen], normals[seen]), value[seen])
    assert (mean > 0.0).all()  # walls and ceiling too
    near = (points[:, 0] > 0.1) & (points[:, 0] < 0.35)
    assert np.abs(mean[grid.entries(points[near], normals[near])] - value[near]).mean() < 0.35
    empty, count = pool(grid, np.zeros(0, np.int64), np.zeros((0, 3)))
    assert (empty == 0.0).all() and (count == 0).all()


def test_lookup_in_kernels_is_the_lookup_in_numpy(rng: np.random.Generator) -> None:
    room = make_room([*BOX, SHELF])
    grid, *_ = filled_grid(room, 50)
    values = rng.normal(size=(len(grid.voxels) * SIDES, 2)).astype(np.float32)
    points, normals, _ = surface_points(room, 4000, rng)
    points, normals = points.astype(np.float32), normals.astype(np.float32)
    flip = rng.random(len(points)) < 0.5
    normals[flip] *= -1
    lookup = SurfaceLookup(grid, values)
    position, side = mi.Point3f(points.T.copy()), mi.Vector3f(normals.T.copy())
    found = np.array([np.array(c) for c in lookup(position, side)]).T
    expected = values[grid.entries(points, normals)]
    # Single precision may fall into the next voxel, but only at a voxel's border.
    same = (found == expected).all(axis=1)
    assert same.mean() > 0.999
    cell = (points + normals * (0.25 * grid.size) - grid.low) / grid.size
    assert (np.abs(cell - np.round(cell)).min(axis=1)[~same] < 1e-3).all()
    off = lookup(position, side, dr.zeros(mi.Bool, len(points)))
    assert (np.array(off[0]) == 0.0).all()


def test_sides_are_dominant_axes() -> None:
    normals = np.array([[1, 0, 0], [-1, 0, 0], [0, 2, -1], [0, -2, 1], [0.5, 0.5, 0.7], [0.1, 0.2, -0.9]])
    assert side_index(normals.astype(float)).tolist() == [0, 1, 2, 3, 4, 5]


def test_grids_do_not_depend_on_scale() -> None:
    """A flat room, and one of 400 m, have as many voxels as their shape in metres asks for."""
    flat = make_room([BOX[0]])
    grid, points, normals, _ = filled_grid(flat)
    assert np.isfinite(grid.size).all() and (grid.size > 0).all()
    assert (np.bincount(grid.entries(points, normals)) > 0).sum() > 500
    large = make_room((np.array(BOX) * 100.0).tolist())
    big, *_ = filled_grid(large)
    small, *_ = filled_grid(make_room(BOX))
    assert abs(len(big.voxels) - len(small.voxels)) < 0.02 * len(small.voxels)


@pytest.mark.parametrize("rim_width", [1, 2])
def test_rim_pixels_of_an_emitter_stay_out_of_the_cache(tmp_path: Path, rim_width: int) -> None:
    """A bright rim one pixel wide is the lamp's own light: cells beside the lamp keep the wall's radiance."""
    pixels = make_pixels(tmp_path / "pixels", 6)
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        on_panel = (np.asarray(pixels.triangle[rows]) >= 12).reshape(view.height, view.width)
        rim = binary_dilation(on_panel, np.ones((3, 3)), iterations=rim_width).ravel()
        pixels.own[rows] = np.where(rim, 100.0, WALL_RADIANCE)[:, None]
    cache = observe(ROOM, pixels, PARTS, SETTINGS, tmp_path / "observed").cache(without=IS_PANEL)
    assert (cache == WALL_RADIANCE).all() == (rim_width == 1)
