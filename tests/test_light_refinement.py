# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage 3: paths that follow gloss and weigh emitters rightly."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.light.cache import SurfaceLookup
from fipt_blender.core.light.radiance import TracedRadiance
from fipt_blender.core.light.shadings import SampleCounts
from fipt_blender.core.optics import brdf
from fipt_blender.core.surface.room import Room
from samples.shading_points import (
    LAMP,
    LEVELS,
    NOTHING,
    baked,
    grid_of,
    lanes,
    lookup_by_triangle,
    mean_and_error,
    points_on,
)
from samples.small_rooms import BOX, agree, area_lights, make_room, table


def shiny_box(roughness: float, metallic: float = 1.0) -> tuple[Room, np.ndarray]:
    """A box with a shiny floor, and the (T, 5) materials of its triangles; 12 and 13 are the lamp."""
    room = make_room([*BOX, LAMP])
    materials = np.tile([0.6, 0.5, 0.4, 1.0, 0.0], (14, 1))
    materials[:2] = [0.9, 0.8, 0.7, roughness, metallic]
    return room, materials


@pytest.mark.parametrize(
    ("roughness", "metallic", "known"), [(0.06, 1.0, []), (0.3, 1.0, []), (0.3, 0.2, [0]), (0.2, 0.0, [0, 1])]
)
def test_refinement_weighs_emitter_and_brdf_samples_rightly(
    roughness: float, metallic: float, known: list[int]
) -> None:
    """Paths over the shiny floor with emitter sampling equal paths that only sample the BRDF.

    On the triangles `known` L_d is looked up, and paths follow the gloss alone.
    """
    room, materials = shiny_box(roughness, metallic)
    grid = grid_of(room)
    lookup = lookup_by_triangle(room, grid, materials)
    walls = np.random.default_rng(2).uniform(0.2, 0.6, (14, 3))
    cached = lookup_by_triangle(room, grid, walls)
    shading = np.full((14, 3), -1.0)
    shading[known] = [0.4, 0.3, 0.2]
    gathered = lookup_by_triangle(room, grid, shading)
    emission = [6.0, 5.0, 4.0]
    lights = area_lights(room, table([12, 13], emission))
    source = TracedRadiance(room, cached, lookup, gathered if known else None, lights, None, 0.6, 4)
    # On the ceiling the lamp's back hides nothing of the floor that matters; it emits nothing upwards.
    points = points_on(room, 6, [4, 5, 6])
    diffuse, specular = baked(points, source, lights, LEVELS, SampleCounts(32, 8, 16), 400)
    times = 40_000
    position, frame, _ = lanes(points, times)
    rng = mi.PCG32(dr.width(position), 5)
    direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32())))
    origin = position + frame.n * room.offset
    throughput, total = mi.Color3f(1.0), mi.Color3f(0.0)
    active = mi.Bool(True)
    for depth in range(1, 5):
        hit = room.intersect(mi.Ray3f(origin, direction), active)
        active &= hit.valid
        lamp = active & (hit.triangle >= 12)
        total += dr.select(lamp & hit.front, throughput * mi.Color3f(emission), 0.0)
        active &= ~lamp
        side = dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)
        r, g, b, sigma, metal = lookup(hit.position, side, active)
        ends = active & ((sigma > 0.6) | (depth == 4))
        total += dr.select(ends, throughput * mi.Color3f(*cached(hit.position, side, ends)), 0.0)
        active &= ~ends
        color = mi.Color3f(r, g, b)
        light = mi.Color3f(*gathered(hit.position, side, active))
        dark = active & (light.x < 0.0)  # L_d is not known there
        total += dr.select(active & ~dark, throughput * color * (1.0 - metal) * light, 0.0)
        color = dr.select(dark, color, 0.04 * (1.0 - metal) + metal * color)
        metal = dr.select(dark, metal, 1.0)
        local = mi.Frame3f(hit.normal)
        pair = mi.Point2f(rng.next_float32(), rng.next_float32())
        wo = local.to_local(-direction)
        wi, gain, _ = brdf.sample(rng.next_float32(), pair, wo, color, sigma, metal)
        throughput *= gain
        direction = local.to_world(wi)
        active &= (wi.z > 0.0) & (dr.dot(direction, side) > 0.0)
        origin = hit.position + side * room.offset
    mean, error = mean_and_error(diffuse)
    expected, noise = mean_and_error(np.array(total).T.reshape(len(points.position), times, 3))
    agree(mean - expected, np.hypot(error, noise))
    assert np.isfinite(specular).all()
    assert np.median(error / mean) < 0.02


def test_looking_up_the_diffuse_shading_changes_no_mean() -> None:
    """Between walls that all send radiance 1, L_d is 1, and a glossy floor looks the same either way."""
    room, materials = shiny_box(0.4, 0.3)
    grid = grid_of(room)
    lookup = lookup_by_triangle(room, grid, materials)
    ones = SurfaceLookup(grid, np.ones((len(grid.voxels) * 6, 3), np.float32))
    points = points_on(room, 4, [4, 6, 8])
    found = []
    for diffuse in (None, ones):
        source = TracedRadiance(room, ones, lookup, diffuse, area_lights(room, NOTHING), None, 0.6, 5)
        counts = SampleCounts(32, 8, 0)
        found.append(mean_and_error(baked(points, source, area_lights(room, NOTHING), LEVELS, counts, 300)[0]))
    (traced, noise), (looked_up, error) = found
    agree(traced - looked_up, np.hypot(noise, error))
    assert (traced.min(axis=1) < 0.99).all()  # the floor matters
