"""The radiance cache, and shadings: the factorisation is the rendering equation, furnaces, emitters, stage 3."""

import itertools
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from benchmarks.tracer.forward import LitRoom, RenderSettings, trace_paths
from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import SUBPIXELS, TriangleTables, denoised, start_points
from fipt_blender.core.light.cache import SIDES, SurfaceLookup, pool
from fipt_blender.core.light.observations import observe
from fipt_blender.core.light.radiance import CachedRadiance, TracedRadiance, new_path
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, Shadings, bake, roughness_levels
from fipt_blender.core.optics import brdf
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.pixels.store import create_pixels, fill_pixels
from fipt_blender.core.surface.room import Room
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, WALL_RADIANCE, make_pixels
from samples.shading_points import (
    LAMP,
    LEVELS,
    NOTHING,
    baked,
    grid_of,
    lanes,
    lookup_by_triangle,
    make_grid,
    mean_and_error,
    points_on,
)
from samples.small_rooms import BOX, agree, area_lights, make_room, room_with_bulb, surface_points, table

BLOCK = [[-0.6, -0.1, 2.0], [0.3, -0.1, 2.0], [0.3, 0.5, 2.0], [-0.6, 0.5, 2.0]]


@cache
def occluded_room() -> Room:
    """A box with a lamp behind a board, and a closed bulb whose far side its near side hides."""
    return room_with_bulb(0.25, (1.2, -1.0, 1.2), [*BOX, LAMP, BLOCK])


def reflected(points: ShadingPoints, source, color: list[float], roughness: float, metallic: float, times: int):
    """Direct integration of the whole BRDF at each point: (points, times, 3) estimates."""
    position, frame, wo = lanes(points, times)
    rng = mi.PCG32(dr.width(position), 11)
    sample2 = mi.Point2f(rng.next_float32(), rng.next_float32())
    wi, weight, _ = brdf.sample(rng.next_float32(), sample2, wo, mi.Color3f(color), roughness, metallic)
    direction = frame.to_world(wi)
    ray = mi.Ray3f(position + frame.n * source.offset, direction)
    active = wi.z > 0.0
    path, _, _ = source.step(new_path(dr.width(position)), direction, source.intersect(ray, active), rng, active)
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
        expected, noise = mean_and_error(reflected(points, source, color.tolist(), float(roughness), metallic, 30_000))
        agree(mean - expected, np.hypot(error, noise))
        assert np.median(error / mean) < 0.03  # tight enough to tell a wrong weight


def lobe_albedo(cos_o: float, roughness: float) -> float:
    """Integral of D G / (4 cos_o) over the hemisphere by quadrature, in double precision."""
    # Half vectors in the GGX distribution's own measure, so that sharp lobes need no fine grid.
    n = 400
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


def lit_by_lamps_alone(room: Room, lights: AreaLights) -> TracedRadiance:
    """Matt surfaces, and a cache that is black."""
    grid = grid_of(room)
    materials = lookup_by_triangle(room, grid, np.tile([0.5, 0.5, 0.5, 1.0, 0.0], (len(room.triangles), 1)))
    black = SurfaceLookup(grid, np.zeros((len(grid.voxels) * 6, 3), np.float32))
    return TracedRadiance(room, black, materials, None, lights, None, 0.6, 5)


def assert_lit_by_lamp(points: ShadingPoints, lift: float, diffuse: np.ndarray, tight: float) -> None:
    """By Lambert's formula, within `tight` and the estimates' own errors; `lift`: metres above the surface."""
    mean, error = mean_and_error(diffuse)
    lifted = (points.position + lift * points.normal).astype(float)
    exact = [rectangle_irradiance(p, n, np.array(LAMP)) / np.pi for p, n in zip(lifted, points.normal, strict=True)]
    agree(mean - np.outer(exact, [5.0, 4.0, 3.0]), error)
    assert np.median(error / mean) < tight


@pytest.mark.parametrize("aimed", [0, 32])
def test_direct_light_of_a_rectangle_is_lambert_formula(aimed: int) -> None:
    room = make_room([BOX[0], LAMP])
    lights = area_lights(room, table([2, 3], [5.0, 4.0, 3.0]))
    points = points_on(room, 6, [0, 1])
    counts = SampleCounts(32, 4, aimed)
    diffuse, _ = baked(points, lit_by_lamps_alone(room, lights), lights, LEVELS, counts, 256)
    assert_lit_by_lamp(points, 0.0, diffuse, 0.02 if aimed else 0.06)


def test_a_lamp_of_small_triangles_is_hit_from_high_above_a_scan() -> None:
    """Rays start 2 cm above the surface, and the lamp's triangles are 5 cm wide."""
    cells = np.linspace(-0.5, 0.5, 21)
    tiles = [
        [[x, y, 2.6], [x, v, 2.6], [u, v, 2.6], [u, y, 2.6]]
        for x, u in itertools.pairwise(cells)
        for y, v in itertools.pairwise(cells)
    ]
    wall = [[-2.0, 2.0, 0.0], [2.0, 2.0, 0.0], [2.0, 2.0, 2.0], [-2.0, 2.0, 2.0]]
    room = replace(make_room([wall, *tiles]), noise=0.01)
    lights = area_lights(room, table(list(range(2, 2 + 2 * len(tiles))), [5.0, 4.0, 3.0]))
    points = points_on(room, 6, [0, 1])
    counts = SampleCounts(4, 4, 64)
    diffuse, _ = baked(points, lit_by_lamps_alone(room, lights), lights, LEVELS[2:], counts, 64)
    assert_lit_by_lamp(points, room.offset, diffuse, 0.04)


def test_starts_of_a_pixel_are_averaged() -> None:
    room = occluded_room()
    grid = grid_of(room)
    values = np.random.default_rng(5).uniform(0.0, 1.0, (len(grid.voxels) * 6, 3)).astype(np.float32)
    source = CachedRadiance(room, SurfaceLookup(grid, values), None)
    points = points_on(room, 4, [0, 1])
    lights = area_lights(room, NOTHING)
    each, noise = mean_and_error(baked(points, source, lights, LEVELS, SampleCounts(16, 8, 0), 400)[0])
    pairs = ShadingPoints(
        *(np.tile(getattr(points, name).reshape(4, 6), (400, 1)).reshape(-1, 3) for name in points.__annotations__)
    )
    together = bake(pairs, source, lights, LEVELS, SampleCounts(16, 8, 0), 3, starts=2)
    assert together.specular.shape == (1600, len(LEVELS), 2, 3)
    mean, error = mean_and_error(together.diffuse.reshape(400, 4, 3).transpose(1, 0, 2))
    expected = each.reshape(4, 2, 3).mean(axis=1)
    agree(mean - expected, np.hypot(error, np.sqrt((noise.reshape(4, 2, 3) ** 2).sum(axis=1)) / 2.0))


def test_levels_and_seeds() -> None:
    assert np.allclose(roughness_levels(6, 0.02, 1.0), np.linspace(0.02, 1.0, 6))
    levels = roughness_levels(8, 0.02, 1.5)
    assert levels[0] == np.float32(0.02) and levels[-1] == 1.0 and (np.diff(levels, 2) > 0).all()
    room = occluded_room()
    grid = grid_of(room)
    source = CachedRadiance(room, SurfaceLookup(grid, np.ones((len(grid.voxels) * 6, 3), np.float32)), None)
    points = points_on(room, 2, [0])
    runs = [bake(points, source, area_lights(room, NOTHING), LEVELS, SampleCounts(8, 4, 8), seed) for seed in (1, 1, 2)]
    assert (runs[0].specular == runs[1].specular).all() and (runs[0].diffuse == runs[1].diffuse).all()
    assert (runs[0].specular != runs[2].specular).any()


WIDTH, HEIGHT = 9, 5


def roof(gap: float) -> Room:
    """Two slopes that fall away from the line x = 0.01, the right one `gap` metres lower."""
    left = [[-3, -3, -3], [0.01, -3, 0], [0.01, 3, 0], [-3, 3, -3]]
    right = [[0.01, -3, -gap], [3, -3, -3 - gap], [3, 3, -3 - gap], [0.01, 3, -gap]]
    return make_room([left, right])


def starts(tmp_path: Path, gap: float, labels: list[int]) -> list[np.ndarray]:
    """Slope (sign of the normal's x) at which each pixel starts, centre first, then each of SUBPIXELS."""
    image = tmp_path / "image.exr"
    write_exr(image, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.0, 0.0, 2.0]
    # The middle column's centre looks at x = 0, its right quarter over the ridge.
    view = View("train/0", "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)
    room = roof(gap)
    store = create_pixels(tmp_path / "pixels", [view])
    fill_pixels(store, room, lambda done: None)
    tables = TriangleTables.of(room, np.array(labels))
    rows = np.arange(WIDTH * HEIGHT)[::-1]  # any pixels in any order
    points = start_points(room, store.of_view(0), rows, tables)
    position, normal, geometric, view_direction = (
        np.array(getattr(points, item.name)).T.reshape(len(rows), len(SUBPIXELS), 3)[::-1] for item in fields(points)
    )
    # a start's directions belong to its own surface point
    toward = pose[:3, 3] - position
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    np.testing.assert_allclose(view_direction, toward, atol=1e-6)
    np.testing.assert_allclose(np.abs((normal * geometric).sum(axis=-1)), 1.0, atol=1e-6)
    assert ((normal * toward).sum(axis=-1) > 0.0).all() and ((geometric * toward).sum(axis=-1) > 0.0).all()
    centre = np.sign(store.normal[:, 0])
    return [slopes.reshape(HEIGHT, WIDTH) for slopes in (centre, *np.sign(normal[..., 0]).T)]


def test_a_pixel_over_a_ridge_starts_on_both_slopes(tmp_path: Path) -> None:
    centre, *moved = starts(tmp_path, 0.0, [0, 0, 0, 0])
    middle = WIDTH // 2
    assert (centre[:, middle] == -1.0).all()
    right = [shift[0] > 0.1 for shift in SUBPIXELS]
    assert any(right) and not all(right)
    for slopes, over in zip(moved, right, strict=True):
        assert (slopes[:, middle] == (1.0 if over else -1.0)).all()
        assert (slopes[:, :middle] == -1.0).all() and (slopes[:, middle + 1 :] == 1.0).all()


@pytest.mark.parametrize("gap, labels", [(0.0, [0, 0, 1, 1]), (1.5, [0, 0, 0, 0])])
def test_other_parts_and_what_lies_behind_are_no_start(tmp_path: Path, gap: float, labels: list[int]) -> None:
    centre, *moved = starts(tmp_path, gap, labels)
    for slopes in moved:
        assert (slopes == centre).all()


def test_specular_shadings_are_denoised_by_their_brightness() -> None:
    """Four levels, which are not a number of whole images; terms and channels keep their proportions."""
    rng = np.random.default_rng(2)
    height, width, levels = 48, 64, 4
    down, right = np.mgrid[:height, :width] / height
    color = rng.uniform(0.2, 1.0, (levels, 2, 3))
    true = (1.0 + 0.5 * np.sin(3.0 * right + down)).reshape(-1, 1, 1, 1) * color
    noise = rng.gamma(1.0, 1.0, (len(true), levels, 1, 1))
    noisy = (true * noise).astype(np.float32)
    noisy[:width] = 0.0
    shadings = Shadings(noisy[:, 0, 0].copy(), noisy.copy())
    normal = np.tile(np.float32([0.0, 0.0, 1.0]), (len(true), 1))
    both = denoised(shadings, normal, (height, width), True)
    alone = denoised(shadings, normal, (height, width), False)
    np.testing.assert_array_equal(alone.specular, noisy)
    np.testing.assert_array_equal(alone.diffuse, both.diffuse)
    lit = slice(8 * width, None)  # away from the dark rows
    before, after = (np.abs(array[lit] / true[lit] - 1.0).mean() for array in (noisy, both.specular))
    assert after < 0.2 * before
    shares = both.specular[lit] / both.specular[lit].sum(axis=(2, 3), keepdims=True)
    expected = np.broadcast_to(color / color.sum(axis=(1, 2), keepdims=True), shares.shape)
    np.testing.assert_allclose(shares, expected, rtol=1e-4)
    assert (both.specular[:width] == 0.0).all()


def shiny_box(roughness: float, metallic: float = 1.0) -> tuple[Room, np.ndarray]:
    """A box with a shiny floor, and the (T, 5) materials of its triangles; 12 and 13 are the lamp."""
    room = make_room([*BOX, LAMP])
    materials = np.tile([0.6, 0.5, 0.4, 1.0, 0.0], (14, 1))
    materials[:2] = [0.9, 0.8, 0.7, roughness, metallic]
    return room, materials


@pytest.mark.parametrize(("roughness", "metallic"), [(0.06, 1.0), (0.3, 1.0), (0.2, 0.0)])
def test_refinement_weighs_emitter_and_brdf_samples_rightly(roughness: float, metallic: float) -> None:
    """Against path tracing of a room whose walls shine what the cache says of them."""
    room, materials = shiny_box(roughness, metallic)
    grid = grid_of(room)
    shine = np.repeat(np.random.default_rng(2).uniform(0.2, 0.6, (7, 3)).astype(np.float32), 2, axis=0)
    shine[12:] = [6.0, 5.0, 4.0]
    cached, lookup = (lookup_by_triangle(room, grid, values) for values in (shine, materials))
    lights = area_lights(room, table([12, 13], [6.0, 5.0, 4.0]))
    source = TracedRadiance(room, cached, lookup, None, lights, None, 0.6, 4)
    # There the lamp's back, which emits nothing, hides little.
    points = points_on(room, 6, [4, 5, 6])
    diffuse, specular = baked(points, source, lights, LEVELS, SampleCounts(32, 8, 16), 400)
    shining = EmitterTable(np.arange(2, 14, dtype=np.int32), shine[2:], np.zeros((12, 3), np.float32))
    surfaces = TriangleMaterials(materials[:, :3], materials[:, 3], materials[:, 4])
    lit, times = LitRoom(room, surfaces, area_lights(room, shining)), 40_000
    position, frame, _ = lanes(points, times)
    rng = mi.PCG32(dr.width(position), 5)
    direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32())))
    ray = mi.Ray3f(position + frame.n * room.offset, direction)
    traced = np.array(trace_paths(lit, ray, rng, RenderSettings(depth=6)).radiance).T
    mean, error = mean_and_error(diffuse)
    expected, noise = mean_and_error(traced.reshape(len(points.position), times, 3))
    agree(mean - expected, np.hypot(error, noise))
    assert np.isfinite(specular).all()
    assert np.median(error / mean) < 0.02


def test_looking_up_the_diffuse_shading_changes_no_mean() -> None:
    """Between walls that all send radiance 1, L_d is 1, and a glossy floor looks the same, however much is known."""
    room, materials = shiny_box(0.4, 0.3)
    grid = grid_of(room)
    lookup = lookup_by_triangle(room, grid, materials)
    known = np.ones((len(grid.voxels) * 6, 3), np.float32)
    ones = SurfaceLookup(grid, known)
    half = SurfaceLookup(grid, np.where(np.arange(len(known))[:, None] // 6 % 2, known, -1.0).astype(np.float32))
    points = points_on(room, 4, [4, 6, 8])
    found = []
    for diffuse in (None, ones, half):
        source = TracedRadiance(room, ones, lookup, diffuse, area_lights(room, NOTHING), None, 0.6, 5)
        counts = SampleCounts(32, 8, 0)
        found.append(mean_and_error(baked(points, source, area_lights(room, NOTHING), LEVELS, counts, 300)[0]))
    traced, noise = found[0]
    for looked_up, error in found[1:]:
        agree(traced - looked_up, np.hypot(noise, error))
    assert (traced.min(axis=1) < 0.99).all()  # the floor matters


SHELF = [[-1.0, 0.3, 1.0], [1.0, 0.3, 1.0], [1.2, 0.9, 1.7], [-0.8, 0.9, 1.7]]


def filled_grid(room, resolution: int = 32):
    rng = np.random.default_rng(0)
    points, normals, triangle = surface_points(room, 3000, rng)
    return make_grid(room, points, normals, resolution, rng), points, normals, triangle


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
