"""Light that no photograph shows as it is: outside, from what nothing shows, and of clipped lamps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.capture.views import View
from fipt_blender.core.conventions import equirect_pixel_directions
from fipt_blender.core.estimate.light_stages import light_excess
from fipt_blender.core.light import sources
from fipt_blender.core.light.cache import SurfaceLookup
from fipt_blender.core.light.clipped import ON_LAMP, OUTSIDE, LitPoints, hemisphere_rays, light_on_points, solve_lamps
from fipt_blender.core.light.clipped import Expectation as LampExpectation
from fipt_blender.core.light.environment import Environment, Hull, estimate_environment
from fipt_blender.core.light.observations import Observations
from fipt_blender.core.light.radiance import CachedRadiance, OutsideRadiance
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, bake
from fipt_blender.core.light.sources import SPECULAR, Expectation, SourceLight, Transport, held_back_gain, solve_sources
from fipt_blender.core.light.unseen_light import Sources, free_radius, lamp_light, with_unseen_light
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.pixels.store import create_pixels, trace_view
from fipt_blender.core.run.settings import Settings
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.shading_points import grid_of
from samples.small_captures import CAMERAS, few_sources, pinhole
from samples.small_rooms import BOX, make_room

CEILING = 1  # quadrilateral of the box
ALBEDO = np.array([[0.4, 0.4, 0.4], [0.7, 0.7, 0.7], [0.5, 0.1, 0.1], [0.6, 0.5, 0.4], [0.25, 0.3, 0.35]])
INDIRECT = 0.5  # radiance of all surfaces that the photographs show
LAMP = np.array([30.0, 28.0, 24.0])  # of a square metre of what they don't show
CORNER = np.array([0.3, -1.2])


def shines(place: np.ndarray) -> np.ndarray:
    """(..., 3) radiance of places at the height of the ceiling: dim, with a lamp of a square metre."""
    return np.where((np.abs(place[..., :2] - CORNER) < 0.5).all(axis=-1, keepdims=True), LAMP, 0.1)


def light(room: Room, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N, 3) irradiance over pi at points of a box, the triangles of whose ceiling are 2 and 3, if any."""
    ceiling = np.zeros(len(room.triangles), np.int32) - 1
    if len(room.triangles) >= 12:
        ceiling[2 * CEILING : 2 * CEILING + 2] = 0
    entry, way = hemisphere_rays(room, grid_of(room), position, normal, ceiling, 5, 512)
    reach = (3.0 - position[:, None, 2]) / np.maximum(way[..., 2], 1e-3)
    above = shines(position[:, None] + reach[..., None] * way)
    return np.where(((entry == OUTSIDE) | (entry == ON_LAMP))[..., None], above, INDIRECT).mean(axis=1)


def observations(folder: Path, room: Room, lit: bool = True, lamps: EmitterTable | None = None) -> Observations:
    """Pixels of a diffuse room that no view shows the ceiling of, with a texture of a tenth.

    Args:
        lit: by what no view shows. lamps: that light it, too.
    """
    views = [
        View(str(index), "train", Path("none"), **vars(pinhole(look_at(start, [*end[:2], 0.0]))))
        for index, (start, end) in enumerate(CAMERAS)
    ]
    pixels = create_pixels(folder, views)
    for index, view in enumerate(views):
        rows, traced = pixels.rows(index), trace_view(room, view)
        for name in ("position", "normal", "triangle", "front"):
            getattr(pixels, name)[rows] = getattr(traced, name)
    triangle = np.asarray(pixels.triangle)
    middle = room.vertices[room.triangles].mean(axis=1)
    pixels.triangle[:] = np.where(middle[triangle, 2] > 2.9, -1, triangle)
    hit = np.flatnonzero(np.asarray(pixels.triangle) >= 0)[::14]
    triangle = np.asarray(pixels.triangle[hit])
    normal = room.normals[triangle]
    normal *= np.where(pixels.front[hit], 1.0, -1.0)[:, None]
    position = np.asarray(pixels.position[hit])
    irradiance = light(room, position, normal) if lit else np.full((len(hit), 3), INDIRECT)
    if lamps is not None:
        irradiance += lamp_light(room, grid_of(room), lamps, (position, normal), 7)
    texture = np.exp(np.random.default_rng(1).normal(0.0, 0.1, (len(hit), 1)))
    color = ALBEDO[np.unique(np.round(4.0 * normal), axis=0, return_inverse=True)[1].reshape(-1) % 5]
    pixels.own[hit] = color * irradiance * texture
    pixels.pure[hit], pixels.weight[hit] = True, 1.0
    grid = grid_of(room)
    entry = np.full(len(pixels), -1, np.int32)
    entry[hit] = grid.entries(position, normal)

    class Shown(Observations):
        """All that photographs show is alike, which is simpler than rooms are."""

        def cache(self, without: np.ndarray | None = None) -> np.ndarray:
            return np.full((len(grid.voxels) * 6, 3), INDIRECT, np.float32)

    return Shown(pixels, None, None, grid, entry, None, 0.02, folder, entry < -1)  # type: ignore[arg-type]


def found_light(observed: Observations, room: Room, lamps: EmitterTable | None = None) -> Observations:
    normals = room.normals
    label = np.unique(np.round(normals), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)
    settings = replace(Settings(), environment_width=32)
    return with_unseen_light(observed, room, label, lamps or EmitterTable.empty(), settings)


@pytest.mark.parametrize("quads", [[BOX[0], *BOX[2:]], BOX], ids=["no ceiling", "unseen ceiling"])
def test_a_lamp_that_no_view_shows_is_found_at_its_place(
    tmp_path: Path, quads: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    few_sources(monkeypatch)
    room = make_room(quads)
    observed = observations(tmp_path, room)
    found = found_light(observed, room).environment
    assert found is not None and found.hull is not None
    floor = np.array([[x, y, 0.01] for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)])
    up = np.tile([0.0, 0.0, 1.0], (len(floor), 1))
    true = light(room, floor, up)
    entry, way = hemisphere_rays(room, grid_of(room), floor, up, np.full(len(room.triangles), -1), 3, 2048)
    cache = np.full((len(grid_of(room).voxels) * 6, 3), INDIRECT)
    cache[found.entries] = found.radiance
    near = found.hull.radiance[found.hull.cells(np.broadcast_to(floor[:, None], way.shape), way)]
    by_found = np.where((entry >= 0)[..., None], cache[np.maximum(entry, 0)], near).mean(axis=1)
    ratio = np.log(by_found / true)
    # Five albedos tell the level; how the light falls on the floor is clear.
    assert abs(ratio.mean()) < 0.4 and ratio.std(axis=0).max() < 0.12, (ratio.mean(0), ratio.std(axis=0))
    dark = np.full((len(observed.pixels), 3), np.nan, np.float32)
    dark[found.pixels] = found.light
    assert light_excess(found, dark) == 0.0 and light_excess(found, 0.9 * dark) == pytest.approx(-0.1, abs=1e-6)
    assert abs(light_excess(found, baked(observed, room, found))) < 0.05, "shadings have the light that was solved for"
    for lamp in found.lamps:
        facing = None if lamp.facing is None else np.array(lamp.facing)
        free = free_radius(np.array(lamp.position), facing, *looks(observed))
        assert lamp.radius <= max(free, 0.05)
    if len(quads) == 6:
        assert found.lamps, "an unseen surface that shines is offered as a lamp"
        disc = max(found.lamps, key=lambda lamp: sum(lamp.radiance) * lamp.radius**2)
        assert np.linalg.norm(np.array(disc.position) - [*CORNER, 2.9]) < 0.6
        assert disc.facing == [0.0, 0.0, -1.0] and 0.3 < disc.radius < 0.9
        power = disc.radius**2 * np.array(disc.radiance)
        assert np.all(np.abs(np.log(power / (LAMP / np.pi))) < 0.5), power
        seen = np.flatnonzero(np.asarray(observed.pixels.triangle) >= 0)[::53]
        normal = room.normals[observed.pixels.triangle[seen]]
        of_lamp = 1.0 - INDIRECT / light(room, observed.pixels.position[seen], normal).mean(axis=1)
        assert sum(lamp.share for lamp in found.lamps) == pytest.approx(of_lamp.mean(), abs=0.1)


def looks(observed: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Cameras, and what their pixels see."""
    rows = np.flatnonzero(np.asarray(observed.pixels.triangle) >= 0)
    return observed.pixels.camera_positions()[observed.pixels.view_of(rows)], observed.pixels.position[rows]


def baked(observed: Observations, room: Room, found: Environment) -> np.ndarray:
    """(N, 3) L_d of the pixels that are compared, as stage 1 bakes it."""
    cache = observed.cache()
    cache[found.entries] = found.radiance
    lights, grid = AreaLights(room.vertices, room.triangles, EmitterTable.empty()), grid_of(room)
    source = CachedRadiance(room, SurfaceLookup(grid, cache), OutsideRadiance(found), lights)
    position, normal = observed.pixels.surface(room, found.pixels)
    points = ShadingPoints(position, normal, normal, normal)
    result = np.zeros((len(observed.pixels), 3), np.float32)
    result[found.pixels] = bake(points, source, lights, np.zeros(0, np.float32), SampleCounts(256, 0, 0), 3).diffuse
    return result


def test_the_light_of_a_bulb_that_views_show_is_not_that_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a thousand rays few hit a bulb of 4 cm, so that its light would be missing in most points."""
    few_sources(monkeypatch)
    bulb = [[x, y, 1.2] for x, y in ((-0.02, -0.02), (-0.02, 0.02), (0.02, 0.02), (0.02, -0.02))]
    room = make_room([*BOX, bulb])
    radiance = np.full((2, 3), 3000.0, np.float32)
    lamps = EmitterTable(np.array([12, 13], np.int32), radiance, np.zeros_like(radiance))
    below = lamp_light(
        room, grid_of(room), lamps, (np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.tile(UP, (2, 1))), 0
    )
    squared = np.array([1.2**2, 1.2**2 + 1.0])
    assert below[:, 0] == pytest.approx(3000.0 * 0.04**2 * (1.2**2 / squared) / (np.pi * squared), rel=0.02)
    observed = observations(tmp_path, room, lamps=lamps)
    found = found_light(observed, room, lamps).environment
    assert found is not None
    place = observed.pixels.surface(room, found.pixels)
    true = light(room, *place) + lamp_light(room, grid_of(room), lamps, place, 8)
    ratio = np.log(found.light / true).mean(axis=1)
    assert np.abs(ratio - np.median(ratio)).mean() < 0.1


def test_lamps_are_not_where_photographs_looked_through() -> None:
    camera, seen = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    x = np.array([1.0, 0.0, 0.0])
    assert free_radius(np.array([2.0, 0.3, 0.0]), x, camera, seen) == pytest.approx(0.3)
    assert free_radius(np.array([4.5, 0.3, 0.0]), x, camera, seen) == np.inf  # behind what is seen
    assert free_radius(np.array([2.0, 0.3, 0.4]), None, camera, seen) == pytest.approx(0.5)
    assert free_radius(np.array([-0.3, -0.4, 0.0]), None, camera, seen) == pytest.approx(0.5)


def test_what_shines_through_a_wide_opening_are_lamps_beside_it() -> None:
    """In the world's image it would be far away, and its light would not fall off in the room."""
    x, z = np.meshgrid(np.arange(-1.75, 2.0, 0.5), np.arange(0.25, 3.0, 0.5))  # 12 square metres at y = 2
    place = np.stack([x.ravel(), np.full(x.size, 2.0), z.ravel()], axis=1)
    floor = np.array([[a, b, 0.0] for a in np.linspace(-1.5, 1.5, 7) for b in np.linspace(-4.0, 1.0, 11)])
    toward = place[None] - floor[:, None]
    squared = (toward**2).sum(axis=2)
    unseen = 0.25 * toward[..., 1] * toward[..., 2] / (np.pi * squared**2)
    count, radiance = len(place), np.full((len(place), 3), 10.0)
    found = Sources(
        points=Transport(np.zeros_like(floor), np.zeros(len(floor), int), np.full_like(floor, 0.1), unseen),
        pixel=np.zeros(0, np.int64),
        position=floor,
        normal=np.tile(UP, (len(floor), 1)),
        expected=Expectation(np.zeros((count, 3)), np.ones(count, bool)),
        light=SourceLight(radiance, np.zeros((3, count, 3, count)), 0.1),
        entries=np.zeros(0, np.int64),
        of_entry=np.zeros(0, np.int64),
        cells=SimpleNamespace(size=0.5),  # type: ignore[arg-type]
        of_cell=np.zeros(0, np.int64),
        reflected=np.full((count, 3), 0.01),
        place=place,
        toward=np.tile([0.0, 1.0, 0.0], (count, 1)),
        width=np.full(count, 0.5),
        side=np.full(count, 3),
        looks=(np.zeros((0, 3)), np.zeros((0, 3))),
    )
    cast = np.zeros(len(floor))
    for lamp in found.lamps():
        assert lamp.facing == [0.0, -1.0, 0.0]
        assert lamp.position[1] == pytest.approx(2.0, abs=0.1)
        off = np.array(lamp.position) - floor
        far = (off**2).sum(axis=1) + lamp.radius**2
        cast += lamp.radius**2 * lamp.radiance[0] * off[:, 1] * off[:, 2] / far**2
    ratio = cast / (unseen @ radiance[:, 0])
    assert np.abs(np.log(ratio)).max() < 0.35, ratio


def test_light_that_the_photographs_explain_stays_to_the_bit(tmp_path: Path) -> None:
    room = make_room(BOX)
    observed = observations(tmp_path, room, lit=False)
    assert found_light(observed, room) is observed


def test_the_hull_shines_by_place_where_no_view_looks_outside() -> None:
    rng = np.random.default_rng(4)
    hull = Hull.around((np.array([-1.0, -2.0, 0.0]), np.array([1.0, 2.0, 3.0])), 0.5)
    table = rng.random(hull.radiance.shape).astype(np.float32)
    table[rng.random(len(table)) < 0.2] = -1.0
    seen = np.zeros((16, 32), bool)
    seen[:4] = True
    environment = Environment(np.full((16, 32, 3), 7.0, np.float32), 0.2, seen, hull=replace(hull, radiance=table))
    start = rng.uniform([-0.9, -1.9, 0.1], [0.9, 1.9, 2.9], (500, 3))
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    origin, direction = (
        kind(*[mi.Float(np.ascontiguousarray(column, np.float32)) for column in array.T])
        for kind, array in ((mi.Point3f, start), (mi.Vector3f, way))
    )
    light = np.array(OutsideRadiance(environment).radiance(origin, direction, mi.Bool(True))).T
    near = table[hull.cells(start, way)]
    far = (way[:, 2] > np.sin(np.pi / 4.0)) | (near[:, 0] < 0.0)
    expected = np.where(far[:, None], 7.0, near)
    assert np.isclose(light, expected).all(axis=1).mean() > 0.99  # rays along the borders of cells
    assert dr.width(origin) == 500 and 0.1 < far.mean() < 0.6


def drawn_points(rng: np.random.Generator, sources: int) -> tuple[Transport, Expectation, np.ndarray]:
    """Points that sources light, two of which are bright, and their radiance."""
    count = 1500
    radiance = np.full((sources, 3), 0.3)
    radiance[:2] = [[20.0, 18.0, 15.0], [3.0, 3.0, 3.0]]
    group = np.arange(count) % len(ALBEDO)
    seen = np.exp(rng.normal(-1.0, 0.5, (count, 1))) * np.array([1.0, 0.9, 0.8])
    unseen = 0.2 * rng.dirichlet(np.full(sources, 0.2), count)
    noise = 0.1 * rng.normal(size=(count, 3))
    logs = np.log(ALBEDO[group] * (seen + unseen @ radiance)) + noise
    return (Transport(logs, group, seen, unseen), Expectation(np.zeros((sources, 3)), np.ones(sources, bool)), radiance)


def test_sources_are_found_within_their_errors() -> None:
    points, expected, radiance = drawn_points(np.random.default_rng(2), 12)
    found = solve_sources(points, expected)
    errors = np.sqrt(np.einsum("ckck->ck", found.covariance)).T
    off = np.log(found.radiance / radiance) / errors
    assert np.abs(off[:2]).max() < 3.0 and errors[0].max() < 0.2
    assert np.sqrt(np.mean(off**2)) < 2.0
    share = (points.unseen @ radiance).sum(1) / (points.seen + points.unseen @ radiance).sum(1)
    assert np.abs(found.shares(points).sum(axis=1) - share).mean() < 0.03
    assert 0.0 < found.error(points).max() < 0.2


@pytest.mark.parametrize(("share", "others"), [(0.8, [0.3, 0.2, 0.4, 0.5]), (0.01, [0.08] * 60)])
def test_no_albedo_is_above_white(share: float, others: list[float]) -> None:
    """The light is three times too dim, which makes a surface brighter than white: a large one, or paper."""
    rng, count = np.random.default_rng(4), 2000
    group = np.where(rng.random(count) < share, 0, 1 + rng.integers(0, len(others), count))
    albedo = np.array([0.8, *others])[group, None]
    seen, unseen = np.full((count, 3), 0.3), np.full((count, 1), 0.3) * np.exp(0.1 * rng.normal(size=(count, 1)))
    logs = np.log(albedo * (seen + unseen * 2.0)) + 0.1 * rng.normal(size=(count, 3))
    found = solve_sources(Transport(logs, group, seen, unseen), Expectation(np.full((1, 3), -2.0), np.ones(1, bool)))
    white = logs[group == 0] - np.log(seen + unseen @ found.radiance)[group == 0]
    assert np.exp(white.mean()) < 1.5 * sources.MAX_ALBEDO  # 2.4 with the expected light


def test_a_known_albedo_tells_the_level_and_the_color_of_the_light() -> None:
    """Nothing that photographs show lights the points, so that the level is that of usual albedos."""
    points, expected, radiance = drawn_points(np.random.default_rng(2), 12)
    light = points.unseen @ radiance
    tinted = light * [0.6, 0.5, 0.4]
    logs = np.log((ALBEDO + SPECULAR)[points.group] * tinted)
    known = np.where(np.arange(len(ALBEDO))[:, None] == 1, ALBEDO, np.nan)
    dark = np.full_like(points.seen, 1e-3)
    for given, most in ((known, 0.1), (None, np.inf)):
        found = solve_sources(Transport(logs, points.group, dark, points.unseen, given), expected)
        off = np.log((points.unseen @ found.radiance).mean(axis=0) / tinted.mean(axis=0))
        assert np.abs(off).max() < most
    assert np.abs(off).max() > 0.2  # without it


def test_points_held_back_tell_light_from_noise() -> None:
    points, expected, _ = drawn_points(np.random.default_rng(3), 12)
    block = np.arange(len(points.group)) // len(ALBEDO) % 100
    assert held_back_gain(points, expected, block, np.random.default_rng(0)) > 5.0
    rng = np.random.default_rng(5)
    light = points.seen + points.unseen @ np.exp(expected.log_radiance)
    logs = np.log(ALBEDO[points.group] * light) + 0.3 * rng.normal(size=light.shape)
    assert held_back_gain(replace(points, log_radiance=logs), expected, block, np.random.default_rng(0)) < 1.0
    # An error of the light that is seen, at one place, is no gain however many points show it.
    logs[block < 3] += 1.0
    unseen = np.where(block[:, None] < 3, points.unseen, 0.01 * points.unseen)
    local = replace(points, log_radiance=logs, unseen=unseen)
    assert held_back_gain(local, expected, block, np.random.default_rng(0)) < 3.0


def estimated(directions: np.ndarray, radiance: np.ndarray, width: int, rng: np.random.Generator) -> Environment | None:
    """Of pixels that come in pieces, as views do."""
    pieces = [(directions[first::3], radiance[first::3]) for first in range(3)]
    return estimate_environment(lambda: pieces, width, rng)


def test_pixels_that_look_outside_give_the_map_back(rng: np.random.Generator) -> None:
    image = rng.uniform(0.1, 2.0, (16, 32, 3)).astype(np.float32)
    directions = np.repeat(equirect_pixel_directions(32, 16).reshape(-1, 3), 3, axis=0)
    radiance = np.repeat(image.reshape(-1, 3), 3, axis=0)
    radiance[1::3] *= 50.0  # a stray pixel in each cell: the median forgets it
    order = rng.permutation(len(directions))
    found = estimated(directions[order], radiance[order], 32, rng)
    assert found is not None and found.observed_share == 1.0
    np.testing.assert_array_equal(found.image, image)
    # and rays that leave the room look it up in the same place
    rays = mi.Vector3f(directions[::3].T.astype(np.float32).copy())
    seen = OutsideRadiance(found).radiance(mi.Point3f(0.0), rays, mi.Bool(True))
    np.testing.assert_allclose(np.array(seen).T, image.reshape(-1, 3))


def test_unseen_cells_take_the_nearest_ones(rng: np.random.Generator) -> None:
    """Only a window to the east is seen: everything has its radiance, across the seam of the map too."""
    directions = equirect_pixel_directions(64, 32).reshape(-1, 3)
    east = directions[:, 0] > 0.9
    found = estimated(directions[east], np.tile([[1.0, 2.0, 3.0]], (east.sum(), 1)), 64, rng)
    assert found is not None
    np.testing.assert_allclose(found.image, np.tile([1.0, 2.0, 3.0], (32, 64, 1)), rtol=1e-6)
    assert abs(found.observed_share - 0.05) < 0.01  # (1 - 0.9) / 2 of the sphere
    west = directions[:, 0] < -0.95
    radiance = np.where(east[:, None], 4.0, 1.0) * np.ones(3)
    both = estimated(directions[east | west], radiance[east | west], 64, rng)
    assert both is not None
    flat = both.image.reshape(-1, 3)
    assert (flat[directions[:, 0] > 0.8] == 4.0).mean() > 0.9
    assert (flat[directions[:, 0] < -0.85] == 1.0).mean() > 0.9


def test_no_pixel_outside_or_a_hole_in_the_mesh_is_no_environment(rng: np.random.Generator) -> None:
    assert estimate_environment(lambda: [], 64, rng) is None
    directions = equirect_pixel_directions(256, 128).reshape(-1, 3)
    hole = directions[:, 0] > 0.9995
    assert hole.any()
    assert estimated(directions[hole], np.full((hole.sum(), 3), 5.0), 256, rng) is None


UP = np.array([[0.0, 0.0, 1.0]])


def lamp_of(room):
    """The two triangles after those of the box are one lamp."""
    return np.where(np.isin(np.arange(len(room.triangles)), (12, 13)), 0, -1).astype(np.int32)


def synthetic(contrast: float, seed: int = 0):
    """Points of eight parts that two lamps light, with textures and a tenth of glossy points."""
    rng = np.random.default_rng(seed)
    count, entries = 2500, 400
    cache = rng.normal(-1.0, 0.7, (entries, 3))
    # Rays of one point meet what lies near it: the indirect light varies, too.
    entry = rng.integers(0, 20, (count, 1)) * 20 + rng.integers(0, 20, (count, 32))
    direct = np.stack([np.exp(rng.normal(-4.0, 1.2, count)), np.exp(rng.normal(-5.0, 1.0, count))], axis=1)
    direct = np.concatenate([direct, np.zeros((count, 1))], axis=1)
    radiance = np.array([[60.0, 50.0, 40.0], [200.0, 150.0, 90.0], [1.0, 1.0, 1.0]])
    part = rng.integers(0, 8, count)
    albedo = rng.uniform(0.1, 0.8, (8, 3))[part] * np.exp(rng.normal(0.0, 0.1, (count, 1)))
    light = np.exp(cache)[entry].mean(axis=1) + direct @ radiance
    value = np.log(albedo * light * np.where(rng.random((count, 1)) < 0.1, 2.0, 1.0)) / contrast
    value[rng.random(value.shape) < 0.05] = np.nan
    points = LitPoints(value, part, entry, direct)
    return points, cache / contrast, np.full((3, 3), np.log(4.0) / contrast), radiance


@pytest.mark.parametrize("contrast", [2.3, 3.2])
def test_lamps_and_contrast_come_back(contrast):
    points, cache, bound, radiance = synthetic(contrast)
    found = solve_lamps(points, cache, LampExpectation.of(bound, np.log(2.8)), (np.log(2.8), 1.0))
    assert found.log_contrast[0] == pytest.approx(np.log(contrast), abs=0.03)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.1
    assert found.deviation[:2].max() < 0.15 and found.spread * contrast < 0.2


def test_a_known_error_of_the_model_is_corrected():
    """Light that varies more than the model says: without the correction, the contrast is wrong."""
    contrast = 2.6
    points, cache, bound, radiance = synthetic(contrast)
    light = points.light(cache, radiance, contrast)
    correction = 0.2 * np.log(light)
    points = replace(points, value=points.value + correction / contrast, correction=correction)
    expected = LampExpectation.of(bound, np.log(2.8))
    found = solve_lamps(points, cache, expected, (np.log(2.8), 1.0))
    assert found.log_contrast[0] == pytest.approx(np.log(contrast), abs=0.03)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.1
    wrong = solve_lamps(replace(points, correction=0.0), cache, expected, (np.log(2.8), 1.0))
    assert abs(wrong.log_contrast[0] - np.log(contrast)) > 0.05


def test_a_known_contrast_is_kept_and_a_lamp_that_lights_nothing_is_said_to_be_unknown():
    """Unless it is known from elsewhere: nothing looks outside, which is the third lamp."""
    points, cache, bound, radiance = synthetic(2.6)
    broad = LampExpectation.of(bound, np.log(2.6))
    found = solve_lamps(points, cache, broad, (np.log(2.6), 0.0))
    assert found.log_contrast[0] == pytest.approx(np.log(2.6), abs=1e-3)
    assert np.abs(found.log_radiance[:2] - np.log(radiance[:2])).max() < 0.06
    assert found.deviation[2].min() > 1.5 and np.abs(found.log_radiance[2] - np.log(8.0 * 4.0)).max() < 1e-3
    known = replace(broad, log_radiance=np.full((3, 3), 1.5), deviation=np.array([2.0, 2.0, 0.1]))
    found = solve_lamps(points, cache, known, (np.log(2.6), 0.0))
    assert np.abs(found.log_radiance[2] - 1.5).max() < 1e-3 and found.deviation[2].max() < 0.11


def test_direct_light_of_a_panel_over_the_floor():
    """The analytic irradiance of a small horizontal square: A cos² / (pi d²)."""
    small = [[x, y, 2.9] for x, y in ((-0.05, -0.05), (-0.05, 0.05), (0.05, 0.05), (0.05, -0.05))]
    room = make_room([*BOX, small])
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    entry, direct = light_on_points(room, grid_of(room), (position, np.repeat(UP, 2, 0)), lamp_of(room), 0)
    squared = np.array([2.9**2, 2.9**2 + 1.0])
    expected = 0.01 * (2.9**2 / squared) / (np.pi * squared)
    assert direct[:, 0] == pytest.approx(expected, rel=0.01) and direct[:, 1].max() == 0.0
    assert (entry >= 0).mean() > 0.95
    screen = [[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]]
    room = make_room([*BOX, small, screen])
    _, shaded = light_on_points(room, grid_of(room), (position[:1], UP), lamp_of(room), 0)
    assert shaded.max() == 0.0
