# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked shadings: the factorisation is the rendering equation, furnaces, emitters and mirrors of stage 3."""

from dataclasses import replace
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from small_rooms import BOX, agree, area_lights, bulb, make_room, mesh_room, surface_points, table

from fipt_blender.core.light.cache import SurfaceLookup, VoxelGrid, make_grid, pool
from fipt_blender.core.light.radiance import CachedRadiance, TracedRadiance, new_path
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, bake, roughness_levels
from fipt_blender.core.material import brdf
from fipt_blender.core.render.forward import LitRoom, RenderSettings, trace_paths
from fipt_blender.core.render.lights import EmitterTable
from fipt_blender.core.render.surfaces import TriangleMaterials
from fipt_blender.core.scene.room import Room

LEVELS = np.array([0.1, 0.4, 1.0], np.float32)
LAMP = [[-0.5, -0.5, 2.6], [-0.5, 0.5, 2.6], [0.5, 0.5, 2.6], [0.5, -0.5, 2.6]]
BLOCK = [[-0.6, -0.1, 2.0], [0.3, -0.1, 2.0], [0.3, 0.5, 2.0], [-0.6, 0.5, 2.0]]
NOTHING = EmitterTable.empty()


@cache
def occluded_room() -> Room:
    """A box with a lamp behind a board, and a closed bulb whose far side its near side hides."""
    flat = make_room([*BOX, LAMP, BLOCK])
    vertices, triangles = bulb([1.2, -1.0, 1.2], 0.25)
    return mesh_room(
        np.concatenate([flat.vertices, vertices]),
        np.concatenate([flat.triangles, triangles + len(flat.vertices)]),
        np.concatenate([flat.triangle_object, np.full(8, 8)]),
    )


def grid_of(room: Room, resolution: int = 48) -> VoxelGrid:
    nothing = np.zeros((0, 3))
    return make_grid(room, nothing, nothing, resolution, np.random.default_rng(0))


def lookup_by_triangle(room: Room, grid: VoxelGrid, values: np.ndarray) -> SurfaceLookup:
    """One row of values for each triangle, both sides."""
    points, normals, ids = surface_points(room, 4000, np.random.default_rng(1))
    entries = np.concatenate([grid.entries(points, normals), grid.entries(points, -normals)])
    return SurfaceLookup(grid, pool(grid, entries, np.concatenate([values[ids]] * 2))[0])


def points_on(room: Room, count: int, triangles: list[int]) -> ShadingPoints:
    """Points on fronts of triangles, each seen from a random direction at most 75 degrees off the normal."""
    rng = np.random.default_rng(3)
    position, normal, _ = surface_points(room, count, rng, np.array(triangles))
    frames = np.array([np.linalg.svd(n[None])[2] for n in normal])
    cosine, turn = rng.uniform(0.26, 1.0, len(normal)), rng.uniform(0, 2 * np.pi, len(normal))
    sine = np.sqrt(1 - cosine**2)
    view = normal * cosine[:, None] + frames[:, 1] * (sine * np.cos(turn))[:, None]
    view += frames[:, 2] * (sine * np.sin(turn))[:, None]
    return ShadingPoints(*[np.asarray(a, np.float32) for a in (position, normal, normal, view)])


def repeat(points: ShadingPoints, times: int) -> ShadingPoints:
    return ShadingPoints(
        *[np.repeat(getattr(points, name), times, axis=0) for name in points.__annotations__]
    )


def baked(points: ShadingPoints, source, lights, levels: np.ndarray, counts: SampleCounts, times: int):
    """Independent estimates: diffuse (points, times, 3) and specular (points, times, K, 2, 3)."""
    found = bake(repeat(points, times), source, lights, levels, counts, seed=7)
    shape = (len(points.position), times)
    return found.diffuse.reshape(*shape, 3), found.specular.reshape(*shape, len(levels), 2, 3)


def mean_and_error(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Over axis 1."""
    return values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(values.shape[1])


def lanes(points: ShadingPoints, times: int):
    many = repeat(points, times)
    position, normal = (np.asarray(a).T.copy() for a in (many.position, many.normal))
    frame = mi.Frame3f(mi.Normal3f(normal))
    return mi.Point3f(position), frame, frame.to_local(mi.Vector3f(many.view_direction.T.copy()))


def reflected(
    points: ShadingPoints, source, color: list[float], roughness: float, metallic: float, times: int
):
    """Direct integration of the whole BRDF at each point: (points, times, 3) estimates."""
    position, frame, wo = lanes(points, times)
    rng = mi.PCG32(dr.width(position), 11)
    sample2 = mi.Point2f(rng.next_float32(), rng.next_float32())
    wi, weight, _ = brdf.sample(rng.next_float32(), sample2, wo, mi.Color3f(color), roughness, metallic)
    direction = frame.to_world(wi)
    ray = mi.Ray3f(position + frame.n * source.offset, direction)
    active = wi.z > 0.0
    path, _, _ = source.step(
        new_path(dr.width(position)), direction, source.intersect(ray, active), rng, active
    )
    return np.array(weight * path.radiance).T.reshape(len(points.position), times, 3)


@pytest.mark.parametrize("aimed", [0, 24])
def test_factorisation_is_direct_integration(aimed: int) -> None:
    """kd L_d + ks L_s0 + L_s1 at each level against the BRDF's integral, lamps half hidden."""
    room = occluded_room()
    grid = grid_of(room)
    rng = np.random.default_rng(5)
    values = rng.uniform(0.0, 1.0, (len(grid.voxels) * 6, 3)) ** 2
    lamp_points, lamp_normals, _ = surface_points(room, 3000, rng, np.array([12, 13, *range(16, 24)]))
    values[grid.entries(lamp_points, lamp_normals)] = [30.0, 20.0, 10.0]
    source = CachedRadiance(room, SurfaceLookup(grid, values.astype(np.float32)), None)
    lights = area_lights(room, table([12, 13, *range(16, 24)], [30.0, 20.0, 10.0]))
    points = points_on(room, 4, [0, 1, 4, 9])
    diffuse, specular = baked(points, source, lights, LEVELS, SampleCounts(24, 12, aimed), 512)
    color, metallic = np.array([0.7, 0.4, 0.2]), 0.3
    kd, ks = color * (1 - metallic), 0.04 * (1 - metallic) + color * metallic
    for level, roughness in enumerate(LEVELS):
        total = kd * diffuse + ks * specular[:, :, level, 0] + specular[:, :, level, 1]
        mean, error = mean_and_error(total)
        expected, noise = mean_and_error(
            reflected(points, source, color.tolist(), float(roughness), metallic, 30_000)
        )
        agree(mean - expected, np.hypot(error, noise))
        assert np.median(error / mean) < 0.03  # tight enough to tell a wrong weight


def lobe_albedo(cos_o: float, roughness: float) -> float:
    """Integral of D G / (4 cos_o) over the hemisphere by quadrature, in double precision."""
    # Half vectors in the GGX distribution's own measure, so that sharp lobes need no fine grid.
    n = 1500
    u, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n * 2 * np.pi)
    alpha = roughness**2
    tan2 = alpha**2 * u / (1 - u)
    cos_h = 1 / np.sqrt(1 + tan2)
    h = np.stack([np.sqrt(1 - cos_h**2) * np.cos(phi), np.sqrt(1 - cos_h**2) * np.sin(phi), cos_h])
    wo = np.array([np.sqrt(1 - cos_o**2), 0.0, cos_o])
    dot = np.einsum("i,iab->ab", wo, h)
    cos_i = 2 * dot * h[2] - cos_o
    k = (roughness + 1) ** 2 / 8
    g = cos_i * cos_o / ((cos_i * (1 - k) + k) * (cos_o * (1 - k) + k))
    # d(wi) = 4 (wo.h) d(h), and D cos_h d(h) = du dphi / 2 pi
    value = np.where((cos_i > 0) & (dot > 0), g * dot / (cos_o * cos_h), 0.0)
    return float(value.mean())


@pytest.mark.parametrize("aimed", [0, 16])
def test_furnace(aimed: int) -> None:
    """In a box of one radiance L_d is that radiance, and L_s0 + L_s1 the lobe's directional albedo."""
    room = occluded_room()
    grid = grid_of(room)
    constant = np.array([2.0, 1.0, 0.5], np.float32)
    source = CachedRadiance(room, SurfaceLookup(grid, np.tile(constant, (len(grid.voxels) * 6, 1))), None)
    lights = area_lights(room, table([12, 13, *range(16, 24)], [1.0, 1.0, 1.0]))
    points = points_on(room, 3, [0, 1, 5])
    diffuse, specular = baked(points, source, lights, LEVELS, SampleCounts(32, 16, aimed), 256)
    mean, error = mean_and_error(diffuse)
    agree(mean - constant, error)
    assert np.abs(mean / constant - 1).max() < 0.01
    mean, error = mean_and_error(specular.sum(axis=3))
    cosines = (points.view_direction * points.normal).sum(axis=1)
    albedo = np.array([[lobe_albedo(float(c), float(s)) for s in LEVELS] for c in cosines])
    agree(mean - albedo[:, :, None] * constant, error)
    assert np.abs(mean / (albedo[:, :, None] * constant) - 1).max() < 0.02


def rectangle_irradiance(point: np.ndarray, normal: np.ndarray, corners: np.ndarray) -> float:
    """Lambert's formula: irradiance of a polygon of unit radiance that is wholly above the horizon."""
    toward = corners - point
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    after = np.roll(toward, -1, axis=0)
    axis = np.cross(toward, after)
    angle = np.arccos(np.clip((toward * after).sum(axis=1), -1, 1))
    total = (angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)).sum(axis=0)
    return 0.5 * abs(float(total @ normal))


def dark_cache(room: Room, grid: VoxelGrid) -> SurfaceLookup:
    return SurfaceLookup(grid, np.zeros((len(grid.voxels) * 6, 3), np.float32))


@pytest.mark.parametrize("aimed", [0, 32])
def test_direct_light_of_a_rectangle_is_lambert_formula(aimed: int) -> None:
    room = make_room([BOX[0], LAMP])
    grid = grid_of(room)
    lights = area_lights(room, table([2, 3], [5.0, 4.0, 3.0]))
    materials = lookup_by_triangle(room, grid, np.tile([0.5, 0.5, 0.5, 1.0, 0.0], (4, 1)))
    source = TracedRadiance(room, dark_cache(room, grid), materials, None, lights, None, 0.6, 5)
    points = points_on(room, 6, [0, 1])
    diffuse, _ = baked(points, source, lights, LEVELS, SampleCounts(32, 4, aimed), 256)
    mean, error = mean_and_error(diffuse)
    up = np.array([0.0, 0.0, 1.0])
    exact = [rectangle_irradiance(p.astype(float), up, np.array(LAMP)) / np.pi for p in points.position]
    agree(mean - np.outer(exact, [5.0, 4.0, 3.0]), error)
    assert np.median(error / mean) < (0.02 if aimed else 0.06)


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
    direction = frame.to_world(
        mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    )
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
        found.append(
            mean_and_error(baked(points, source, area_lights(room, NOTHING), LEVELS, counts, 300)[0])
        )
    (traced, noise), (looked_up, error) = found
    agree(traced - looked_up, np.hypot(noise, error))
    assert (traced.min(axis=1) < 0.99).all()  # the floor matters


@pytest.mark.parametrize("roughness", [0.1, 1.0])
def test_what_shines_beside_reflecting_is_read_from_the_cache(roughness: float) -> None:
    """The photographs hold its whole light: it counts once, however bright or rough it was fitted."""
    room, materials = shiny_box(0.1)
    grid = grid_of(room)
    cached = lookup_by_triangle(room, grid, np.linspace(0.5, 2.0, 14)[:, None] * np.ones(3))
    points = points_on(room, 4, [4, 6, 8])
    counts = SampleCounts(16, 4, 16)
    lamp = table([12, 13], [50.0, 40.0, 30.0])
    aimed = area_lights(room, lamp)
    expected = TracedRadiance(
        room,
        cached,
        lookup_by_triangle(room, grid, materials),
        None,
        area_lights(room, NOTHING),
        None,
        0.6,
        5,
    )
    materials[12:, 3] = roughness
    lights = area_lights(room, replace(lamp, beside=np.ones(2, bool)))
    source = TracedRadiance(
        room, cached, lookup_by_triangle(room, grid, materials), None, lights, None, 0.6, 5
    )
    found = [bake(points, each, aimed, LEVELS, counts, 3) for each in (source, expected)]
    np.testing.assert_allclose(found[0].diffuse, found[1].diffuse, rtol=1e-5)
    np.testing.assert_allclose(found[0].specular, found[1].specular, rtol=1e-4, atol=1e-6)


def test_without_a_cache_what_shines_beside_reflecting_lights_the_room() -> None:
    """Lamps that reflect nothing are the same either way."""
    room, materials = shiny_box(0.3)
    materials[12:] = [0.0, 0.0, 0.0, 1.0, 1.0]
    grid = grid_of(room)
    lookup = lookup_by_triangle(room, grid, materials)
    points = points_on(room, 4, [4, 6, 8])
    found = []
    for beside in (None, np.ones(2, bool)):
        lights = area_lights(room, replace(table([12, 13], [6.0, 5.0, 4.0]), beside=beside))
        source = TracedRadiance(room, None, lookup, None, lights, None, 0.6, 4)
        found.append(mean_and_error(baked(points, source, lights, LEVELS, SampleCounts(16, 4, 16), 300)[0]))
    (black, noise), (beside_mean, error) = found
    agree(black - beside_mean, np.hypot(noise, error))


def test_starts_of_a_pixel_are_averaged() -> None:
    room = occluded_room()
    grid = grid_of(room)
    values = np.random.default_rng(5).uniform(0.0, 1.0, (len(grid.voxels) * 6, 3)).astype(np.float32)
    source = CachedRadiance(room, SurfaceLookup(grid, values), None)
    points = points_on(room, 4, [0, 1])
    lights = area_lights(room, NOTHING)
    each, noise = mean_and_error(baked(points, source, lights, LEVELS, SampleCounts(16, 8, 0), 400)[0])
    pairs = ShadingPoints(
        *(
            np.tile(getattr(points, name).reshape(4, 6), (400, 1)).reshape(-1, 3)
            for name in points.__annotations__
        )
    )
    together = bake(pairs, source, lights, LEVELS, SampleCounts(16, 8, 0), 3, starts=2)
    assert together.specular.shape == (1600, len(LEVELS), 2, 3)
    mean, error = mean_and_error(together.diffuse.reshape(400, 4, 3).transpose(1, 0, 2))
    expected = each.reshape(4, 2, 3).mean(axis=1)
    agree(mean - expected, np.hypot(error, np.sqrt((noise.reshape(4, 2, 3) ** 2).sum(axis=1)) / 2.0))


def test_a_mirror_is_seen_by_stage_3_and_blurred_by_stage_1() -> None:
    """Sharp shadings of walls that see a mirror-like floor, against path tracing with the true materials."""
    room, materials = shiny_box(0.06)
    grid = grid_of(room)
    emission = [12.0, 12.0, 12.0]
    lights = area_lights(room, table([12, 13], emission))
    lit = LitRoom(room, TriangleMaterials(materials[:, :3], materials[:, 3], materials[:, 4]), lights)
    rng = np.random.default_rng(8)
    # Photographs from two places: rays over the whole sphere.
    count = 60_000
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.where(np.arange(count)[:, None] % 2, [-1.2, -1.3, 1.5], [1.3, 0.8, 1.2])

    def photograph(origin: np.ndarray, direction: np.ndarray, paths: int, seed: int):
        many = [mi.Point3f(np.repeat(origin, paths, axis=0).T.copy())]
        many.append(mi.Vector3f(np.repeat(direction, paths, axis=0).T.copy()))
        ray = mi.Ray3f(*many)
        found = trace_paths(lit, ray, mi.PCG32(len(origin) * paths, seed), RenderSettings(depth=12))
        return np.array(found.radiance).T.reshape(len(origin), paths, 3)

    image = photograph(origin, direction, 24, 1).mean(axis=1)
    hit = room.intersect(mi.Ray3f(mi.Point3f(origin.T.copy()), mi.Vector3f(direction.T.copy())))
    normal = np.array(dr.select(hit.front, hit.geometric_normal, -hit.geometric_normal)).T
    entries = grid.entries(np.array(hit.position).T.astype(float), normal.astype(float))
    on_lamp = np.array(hit.triangle) >= 12
    with_lamp = SurfaceLookup(grid, pool(grid, entries, image)[0])
    without = SurfaceLookup(grid, pool(grid, entries[~on_lamp], image[~on_lamp])[0])
    # Points of a wall that see the lamp's image, or the ceiling beside it, in the floor.
    position = np.stack([np.full(40, 1.999), rng.uniform(-0.8, 0.8, 40), rng.uniform(1.0, 1.6, 40)], axis=1)
    image_of_lamp = np.stack([rng.uniform(-0.9, 0.9, 40), position[:, 1] * 0.5, np.full(40, -2.6)], axis=1)
    mirror = image_of_lamp - position
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    wall = np.tile([-1.0, 0.0, 0.0], (40, 1))
    view = 2 * (mirror * wall).sum(axis=1, keepdims=True) * wall - mirror
    points = ShadingPoints(*[np.asarray(a, np.float32) for a in (position, wall, wall, view)])
    levels = np.array([0.06], np.float32)
    lookup = lookup_by_triangle(room, grid, materials)
    counts = SampleCounts(8, 256, 16)
    stage_1 = bake(points, CachedRadiance(room, with_lamp, None), lights, levels, counts, 1).specular
    traced = TracedRadiance(room, without, lookup, None, lights, None, 0.6, 5)
    stage_3 = bake(points, traced, lights, levels, counts, 1).specular
    # L_s0 + L_s1 by sampling the lobe and tracing paths
    paths = 2000
    where, frame, wo = lanes(points, paths)
    generator = mi.PCG32(dr.width(where), 9)
    wi = brdf.sample_visible_normal(mi.Point2f(generator.next_float32(), generator.next_float32()), wo, 0.06)
    lobe = sum(brdf.specular_lobes(wi, wo, 0.06)) / brdf.visible_normal_pdf(wi, wo, 0.06)
    ray = mi.Ray3f(where + frame.n * room.offset, frame.to_world(wi))
    radiance = trace_paths(lit, ray, generator, RenderSettings(depth=12)).radiance
    value = np.array(dr.select(wi.z > 0.0, radiance * lobe, 0.0)).T.reshape(40, paths, 3)
    true = value.mean(axis=1)
    error_1 = np.abs(stage_1[:, 0].sum(axis=1) - true).mean() / true.mean()
    error_3 = np.abs(stage_3[:, 0].sum(axis=1) - true).mean() / true.mean()
    assert error_3 < 0.06
    assert error_1 > 5 * error_3


def test_levels_and_seeds() -> None:
    assert np.allclose(roughness_levels(6, 0.02, 1.0), np.linspace(0.02, 1.0, 6))
    levels = roughness_levels(8, 0.02, 1.5)
    assert levels[0] == np.float32(0.02) and levels[-1] == 1.0 and (np.diff(levels, 2) > 0).all()
    room = occluded_room()
    grid = grid_of(room)
    source = CachedRadiance(room, SurfaceLookup(grid, np.ones((len(grid.voxels) * 6, 3), np.float32)), None)
    points = points_on(room, 2, [0])
    runs = [
        bake(points, source, area_lights(room, NOTHING), LEVELS, SampleCounts(8, 4, 8), seed)
        for seed in (1, 1, 2)
    ]
    assert (runs[0].specular == runs[1].specular).all() and (runs[0].diffuse == runs[1].diffuse).all()
    assert (runs[0].specular != runs[2].specular).any()
