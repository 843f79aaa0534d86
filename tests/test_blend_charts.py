# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts of scans: few, hardly stretched, none above itself, and always the same."""

import numpy as np
import pytest

from fipt_blender.blend.room import charts, islands, packing
from fipt_blender.blend.slices import run_through
from fipt_blender.core.textures.raster import cover_count


def grid(rows, columns, closed=False):
    """Triangles of a grid of vertices (rows * columns); the last column meets the first if it is closed."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns - (not closed)), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    quads = np.stack([a, b, b + columns, a + columns], axis=-1).reshape(-1, 4)
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def box(count=50):
    """A welded box of 2 x 1 x 1 m with `count` squares along each edge."""
    steps = np.linspace(-0.5, 0.5, count + 1)
    u, v = np.meshgrid(steps, steps, indexing="ij")
    one = np.full_like(u, 0.5)
    sides = [(one, u, v), (-one, v, u), (v, one, u), (u, -one, v), (u, v, one), (v, u, -one)]
    points = np.concatenate([np.stack(side, axis=-1).reshape(-1, 3) for side in sides])
    triangles = np.concatenate([grid(count + 1, count + 1) + index * (count + 1) ** 2 for index in range(6)])
    return weld(points * [2.0, 1.0, 1.0], triangles)


def cylinder(rows=120, columns=180, radius=0.5, height=2.0):
    """The side of an upright cylinder."""
    z, angle = np.meshgrid(
        np.linspace(0.0, height, rows), np.arange(columns) * (2.0 * np.pi / columns), indexing="ij"
    )
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    return points, grid(rows, columns, closed=True)


def sphere(count=60):
    """A welded sphere with a radius of one metre."""
    points, triangles = box(count)
    points = points / [2.0, 1.0, 1.0]
    return points / np.linalg.norm(points, axis=1, keepdims=True), triangles


def weld(points, triangles):
    _, first, inverse = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    return points[first], inverse.reshape(-1)[triangles]


def noisy(points, triangles, share):
    """Vertices moved at random by a share of the mean length of an edge."""
    edge = np.linalg.norm(points[triangles[:, 0]] - points[triangles[:, 1]], axis=1).mean()
    return points + np.random.default_rng(3).normal(0.0, share * edge, points.shape), triangles


def unwrapped(points, triangles, longest=np.inf):
    polygon = np.arange(len(triangles))
    return run_through(charts.chart_slices(points, triangles, polygon, longest))


def overlap(result, texel):
    """Share of the covered texels that several triangles of the same chart cover."""
    low, extent = islands.island_bounds(result.uv, result.chart)
    packed = packing.pack_islands(extent / texel, np.zeros(len(extent), np.int32), 4096, 1, 64)
    placed = packing.place(result.uv, result.chart, low, packed, 1.0 / texel)
    shared = covered = 0
    for image, size in enumerate(packed.sizes):
        count = cover_count(placed[packed.image[result.chart] == image], *size)
        shared, covered = shared + (count > 1).sum(), covered + (count > 0).sum()
    return shared / covered


def area_shares(result, points, triangles):
    """Area in the plane over area in space of each triangle."""
    return islands.triangle_areas(result.uv) / islands.triangle_areas(points[triangles])


def test_a_box_has_a_chart_for_each_side():
    points, triangles = box()
    result = unwrapped(points, triangles)
    size = np.bincount(result.chart)
    assert len(size) <= 14 and np.sort(size)[-6:].sum() > 0.999 * size.sum()  # and a triangle at corners
    assert size.max() < 1.1 * len(triangles) / 6
    assert overlap(result, 0.005) <= 1e-3
    middle = np.abs(points[triangles].mean(axis=1) / [2.0, 1.0, 1.0])
    inner = np.sort(middle, axis=1)[:, 1] < 0.4  # the smoothing rounds the edges of the box
    assert np.abs(area_shares(result, points, triangles)[inner] - 1.0).max() < 0.01


@pytest.mark.parametrize("shape", [cylinder, sphere])
def test_round_surfaces_are_hardly_stretched(shape):
    points, triangles = shape()
    result = unwrapped(points, triangles)
    assert np.bincount(result.chart).max() < 0.3 * len(triangles)  # no chart reaches around
    assert result.chart.max() < 60
    assert overlap(result, 0.005) <= 1e-3
    shares = area_shares(result, points, triangles)
    assert np.quantile(shares, 0.01) > 0.8 and shares.max() < 1.1


@pytest.mark.parametrize("shape", [box, cylinder, sphere])
def test_noise_does_not_tear_a_surface_apart(shape):
    clean, triangles = shape()
    points, _ = noisy(clean, triangles, share=0.2)
    result = unwrapped(points, triangles)
    size = np.bincount(result.chart)
    assert size[size >= charts.SMALL].sum() > 0.99 * len(triangles)
    assert overlap(result, 0.005) < 0.01
    shares = area_shares(result, clean, triangles)  # as the noise makes triangles larger
    assert np.quantile(shares, 0.01) > 0.4 and np.quantile(shares, 0.99) < 1.6


def test_sheets_above_each_other_are_cut_apart():
    # A ramp that winds up for two turns faces up everywhere, and lies above itself.
    turn, radius = np.meshgrid(np.linspace(0.0, 4.0 * np.pi, 400), np.linspace(0.5, 1.0, 30), indexing="ij")
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.1 * turn], axis=-1).reshape(-1, 3)
    triangles = grid(400, 30)[:, ::-1]
    result = unwrapped(points, triangles)
    assert result.chart.max() > 0
    assert overlap(result, 0.005) <= 1e-3


def test_long_charts_are_cut_and_polygons_stay_whole():
    points, triangles = box()
    polygon = np.repeat(np.arange(len(triangles) // 2), 2)
    result = run_through(charts.chart_slices(points, triangles, polygon, 0.7))
    assert islands.island_bounds(result.uv, result.chart)[1].max() < 0.85
    assert (result.chart[0::2] == result.chart[1::2]).all()


def test_the_result_depends_on_the_mesh_alone():
    points, triangles = noisy(*sphere(40), share=0.3)
    first, second = (unwrapped(points, triangles) for _ in range(2))
    assert np.array_equal(first.uv, second.uv) and np.array_equal(first.chart, second.chart)


def test_scans_are_told_from_modelled_meshes():
    points, triangles = noisy(*sphere(70), share=0.3)
    areas = islands.triangle_areas(points[triangles])
    assert charts.is_scan(areas)
    assert not charts.is_scan(areas[:5000])
    assert not charts.is_scan(np.append(areas, 100.0 * areas.sum()))  # with a wall of one triangle
    assert not charts.is_scan(np.zeros(30_000))


def test_components_and_neighbours():
    assert charts.components(5, np.array([3, 0]), np.array([1, 4])).tolist() == [0, 1, 2, 1, 0]
    beside = charts.neighbours(np.array([[0, 1, 2], [2, 1, 3]]))
    assert beside.tolist() == [[-1, 1, -1], [0, -1, -1]]
