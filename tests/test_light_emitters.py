"""What emits: evidence of pixels, fixtures and their sides, of a scan as a whole, and presumed lamps of stage 1."""

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.cache import SurfaceLookup
from fipt_blender.core.light.emission import (
    brighter_than_white,
    constancy,
    emission_probability,
    log_evidence,
    log_ratio,
)
from fipt_blender.core.light.emitter_surfaces import EmitterSurfaces, emitter_surfaces
from fipt_blender.core.light.emitters import ALIKE, bright_triangles, emitter_components, group_fixtures, presume_lamps
from fipt_blender.core.light.environment import Environment
from fipt_blender.core.light.radiance import CachedRadiance, new_path
from fipt_blender.core.light.scan_fixtures import scan_groups
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.parts.labels import NO_PART, Parts
from fipt_blender.core.pixels.store import NO_TRIANGLE, PixelStore, create_pixels
from fipt_blender.core.surface.room import Room
from samples.scans import scanned_box
from samples.shading_points import grid_of
from samples.small_rooms import BOX, make_room, room_with_bulb

SCAN, SIDE = scanned_box(noise=0.002)
assert SCAN.scan is not None
CENTERS = SCAN.scan.centers
CEILING = 1


def pixels(rows: list[tuple[int, bool, float, float]]) -> PixelStore:
    """Pixels of (triangle, front, weight, grey) rows."""
    triangle, front, weight, grey = (np.array(column) for column in zip(*rows, strict=True))
    own, ones = np.repeat(grey[:, None], 3, axis=1), np.ones(len(grey))
    return PixelStore([], ones, own, ones, ones, triangle, front.astype(bool), ones > 0, own, weight.astype(float))


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
    table = EmitterTable.from_fixtures(fixtures)
    assert table.triangles.tolist() == [12, 13, 14, 15]
    assert table.radiance[:, 1].tolist() == pytest.approx([10.0, 10.0, 4.0, 4.0])
    assert table.back_radiance[:, 2].tolist() == [0.0, 0.0, 3.0, 3.0]
    assert len(EmitterTable.from_fixtures([]).triangles) == 0
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
    table = bright_triangles(room, seen)
    assert table.triangles.tolist() == [12, 13]
    assert table.radiance[:, 0].tolist() == [60.0, 0.0] and table.back_radiance[:, 0].tolist() == [0.0, 40.0]
    assert len(bright_triangles(room, replace(seen, radiance=seen.radiance * 0.0)).triangles) == 0


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
    assert np.array_equal(surfaces.unit, np.arange(12))
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
    bright = bright_triangles(room, seen)
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


# Three quads apart, two triangles each; the views below show the first of each.
WALL, LAMP, BAR = 0, 2, 4
QUAD = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
ROOM = make_room([(QUAD + [2.0 * i, 0.0, 0.0]).tolist() for i in range(3)])
OPTIONS = {".": (WALL, True), "L": (LAMP, True), "l": (LAMP, False), "B": (BAR, True), "b": (BAR, False)}


def store(folder: Path, pictures: list[tuple[list[str], list[list[float]]]], weight: float = 0.5) -> PixelStore:
    """Views of one letter a pixel (OPTIONS: what its centre sees, and capitals where it sees that alone; a
    blank looks outside) and of its grey radiance, which is its own; mixed pixels have the given weight."""
    views = [
        View(f"train/{i}", "train", Path(), len(rows[0]), len(rows), 1.0, 1.0, 0.0, 0.0, np.eye(4))
        for i, (rows, _) in enumerate(pictures)
    ]
    pixels = create_pixels(folder / "pixels", views)
    for index, (rows, grey) in enumerate(pictures):
        seen = [OPTIONS.get(letter, (NO_TRIANGLE, True)) for letter in "".join(rows)]
        place = pixels.rows(index)
        pixels.triangle[place], pixels.pure[place] = np.array(seen).T
        pixels.radiance[place] = pixels.own[place] = np.array(grey, np.float32).reshape(-1, 1)
        pixels.weight[place] = np.where(pixels.pure[place], 1.0, weight)
    return pixels


def probability(
    pixels: PixelStore,
    told: tuple[int, ...] = (),
    diffuse: np.ndarray | float = 1.0,
    environment: Environment | None = None,
    hdr: bool = True,
    **changes: object,
) -> np.ndarray:
    """(T,) probability to emit where L_d is 1, or as given for each pixel, and surfaces are diffuse."""
    ids = np.arange(len(ROOM.triangles))
    surfaces: EmitterSurfaces = replace(emitter_surfaces(ROOM, Parts(ids, "none"), 0.01, environment, hdr), **changes)
    light = np.broadcast_to(np.reshape(diffuse, (-1, 1)), (len(pixels), 3)).astype(np.float16)
    shadings = ShadingStore(light, np.zeros((len(pixels), 2, 2, 3), np.float16), np.array([0.1, 1.0]))
    hints = np.isin(ids, told).astype(np.int8)
    return emission_probability(ROOM, pixels, shadings, lambda rows: light[rows].astype(np.float32), surfaces, hints)


def emission(pixels: PixelStore, **options: object) -> list[int]:
    """Triangles that emit; options of :func:`probability`."""
    return np.flatnonzero(probability(pixels, **options) > 0.5).tolist()  # type: ignore[arg-type]


def test_brighter_than_white_is_evidence_and_what_white_explains_is_none() -> None:
    ratio = np.log([0.02, 0.3, 1.0, 1.2, 2.0, 4.0, 40.0])
    found = log_evidence(ratio - 0.02, ratio + 0.02, np.full(7, 0.15))
    assert (found[:4] < 0.0).all() and (found[4:] > 0.0).all() and (np.diff(found) > 0.0).all()
    rough = log_evidence(ratio - 0.02, ratio + 0.02, np.full(7, 0.6))
    assert (rough[4:] < found[4:]).all()  # light that is known less well explains more
    # An interval that may be anything tells nothing, one that is cut off below by white a little.
    assert log_evidence(np.array([-14.0]), np.array([7.0]), np.array([0.15]))[0] == pytest.approx(0.0, abs=0.01)


def test_light_is_unexplained_channel_by_channel() -> None:
    """A red lamp under white light is as bright as a grey wall."""
    lamp, wall = np.array([[3.0, 0.1, 0.1]]), np.full((1, 3), 0.8)
    assert log_ratio(lamp, np.ones((1, 3)))[0] > np.log(2.0)
    assert log_ratio(wall, np.ones((1, 3)))[0] == pytest.approx(np.log(0.8))
    assert log_ratio(2.0 * wall, np.ones((1, 3)))[0] == pytest.approx(np.log(1.6))


def test_constant_radiance_in_varying_light_is_emitted(rng: np.random.Generator) -> None:
    """A panel against a wall, a textured wall and a surface in even light; few pixels say little."""
    count = 400
    light, noise = np.log(rng.uniform(1.0, 3.0, count)), 0.02 * rng.normal(size=count)
    texture = np.log(rng.uniform(0.2, 0.8, count))
    even = np.full(count, 0.7)
    radiance = np.concatenate([noise, light + noise, light + texture, even + noise])
    found = constancy(radiance, np.concatenate([light, light, light, even]), np.repeat([0, 1, 2, 3], count), 5, 0.03)
    assert found[0] > 20.0 and found[1] < -20.0 and abs(found[2]) < 8.0 and abs(found[3]) < 0.5
    assert found[4] == 0.0
    few = constancy(noise[:20], light[:20], np.zeros(20, np.int64), 1, 0.03)
    assert 0.0 < few[0] < 0.3 * found[0]


def test_a_lamp_much_brighter_than_white_emits(tmp_path: Path) -> None:
    view = (["..BBLL"], [[0.8, 0.8, 1.3, 1.3, 5.0, 5.0]])
    found = probability(store(tmp_path, [view] * 4))
    assert (found[[LAMP, LAMP + 1]] > 0.9).all() and (found[[WALL, BAR]] < 0.05).all()
    assert found[LAMP + 1] == found[LAMP]  # no pixel judged the other triangle of the quad
    # Fewer views and a dimmer lamp are less certain, and no step lies between.
    less = probability(store(tmp_path / "two", [view] * 2))[LAMP]
    dim = (["..BBLL"], [[0.8, 0.8, 1.3, 1.3, 3.0, 3.0]])
    assert 0.02 < less < found[LAMP] and probability(store(tmp_path / "dim", [dim] * 4))[LAMP] < found[LAMP]


def test_what_lies_outside_is_not_brighter_than_white_surfaces(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["..LL??"], [[0.8, 0.8, 5.0, 5.0, 9.0, 9.0]])])
    light = np.ones((len(pixels), 3), np.float16)
    shadings = ShadingStore(light, np.zeros((len(pixels), 2, 2, 3), np.float16), np.array([0.1, 1.0]))
    assert brighter_than_white(pixels, shadings) == 0.5


def test_light_that_may_be_brighter_explains_more(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["..LL"], [[0.8, 0.8, 5.0, 5.0]])] * 4)
    close, seen = np.full(len(ROOM.triangles), 0.5), np.zeros((1, 2), bool)
    inferred = Environment(np.zeros((1, 2, 3)), 0.0, seen, unseen_error=0.5, unseen=0.0 * close)
    changes = ({}, {"environment": inferred}, {"hdr": False}, {"unseen": close})
    found = [probability(pixels, **options)[LAMP] for options in changes]  # type: ignore[arg-type]
    assert found[0] > 0.9 and all(found[0] > other for other in found[1:])
    assert emission(pixels, told=(WALL, WALL + 1)) == [WALL, WALL + 1, LAMP, LAMP + 1]


def test_a_dim_lamp_emits_as_a_part_of_constant_radiance(tmp_path: Path) -> None:
    """As bright as the wall beside it, in light that varies by a factor of four."""
    light = np.linspace(1.0, 4.0, 60)
    dim, wall = np.full(60, 0.9), 0.5 * light
    pixels = store(tmp_path, [(["L" * 60, "." * 60], [dim, wall])] * 3)  # type: ignore[list-item]
    part = np.arange(len(ROOM.triangles)) // 2
    assert emission(pixels, diffuse=np.tile(light, 6), alike=part) == [LAMP, LAMP + 1]
    # Clipped photographs are constant, too.
    assert emission(pixels, diffuse=np.tile(light, 6), alike=part, hdr=False) == []


def test_a_presumed_lamp_is_asked_without_masks_and_hidden_lamps_do_not_explain_it(tmp_path: Path) -> None:
    """Light that was wrongly inferred makes a panel white paper in bright light, but not of one radiance."""
    light = np.linspace(6.0, 20.0, 60)
    pixels = store(tmp_path, [(["L" * 60, "." * 60], [np.full(60, 9.0), 0.5 * light])] * 3)  # type: ignore[list-item]
    count = len(ROOM.triangles)
    inferred = Environment(np.zeros((1, 2, 3)), 0.0, np.zeros((1, 2), bool), unseen=np.ones(count))
    presumed = np.isin(np.arange(count), [LAMP, LAMP + 1])
    for given, found in ((None, []), (presumed, [LAMP, LAMP + 1])):
        surfaces = emitter_surfaces(ROOM, Parts(np.arange(count), "none"), 0.01, inferred, True, given)
        assert emission(pixels, diffuse=np.tile(light, 6), alike=surfaces.alike, unseen=surfaces.unseen) == found


def test_stray_pixels_do_not_decide(tmp_path: Path) -> None:
    """A highlight on the wall in one view, a dark pixel on the lamp in another."""
    bright = (["...LLL"], [[0.8, 0.8, 0.8, 9.0, 9.0, 9.0]])
    views = [(["...LLL"], [[9.0, 0.8, 0.8, 9.0, 9.0, 0.1]]), *[bright] * 5]
    assert emission(store(tmp_path, views)) == [LAMP, LAMP + 1]


def test_a_bar_before_a_lamp_is_no_lamp_in_however_many_views(tmp_path: Path) -> None:
    """No pixel sees it alone. What is left when the lamp is subtracted is uncertain, however bright it is."""
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 19.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path, [(rows, grey)] * 6, weight=0.08)) == [LAMP, LAMP + 1]
    # Light that a lens spreads from the lamp is none of its own, even where the remainder is certain.
    rows, grey = ["LLbLL"] * 3, [[20.0, 20.0, 9.0, 20.0, 20.0]] * 3
    assert emission(store(tmp_path / "lens", [(rows, grey)] * 6, weight=0.9)) == [LAMP, LAMP + 1]


def test_light_that_spills_into_a_pure_pixel_is_no_emission(tmp_path: Path) -> None:
    """The bar is as bright as half the lamp beside it, in one column of pixels; two columns are proof."""
    near = store(tmp_path, [(["LB.."] * 2, [[20.0, 9.0, 0.8, 0.8]] * 2)] * 6)
    assert emission(near) == [LAMP, LAMP + 1]
    wide = store(tmp_path / "wide", [(["LBBB"] * 2, [[20.0, 9.0, 9.0, 9.0]] * 2)] * 6)
    assert emission(wide) == [LAMP, LAMP + 1, BAR, BAR + 1]


def test_unjudged_triangles_are_lamps_as_their_piece_is(tmp_path: Path) -> None:
    pixels = store(tmp_path, [(["LL"], [[9.0, 9.0]])] * 6)
    one = np.zeros(len(ROOM.triangles), np.int64)  # all quads are one piece
    found = probability(pixels, component=one)
    assert found == pytest.approx(found[LAMP])
    apart = probability(pixels)
    assert apart[LAMP + 1] == apart[LAMP] and not apart[[WALL, BAR]].any()


def test_a_rim_that_faces_sideways_on_a_scan_may_show_the_paper_beside_it(tmp_path: Path) -> None:
    """A rim, on which the scan lets little light fall, is as bright as the lit paper beside it."""
    light = np.array([1.0, 1.0, 0.2, 0.2, 1.0, 1.0])
    rim = store(tmp_path, [(["..LL.."], [[0.8, 0.8, 0.9, 0.9, 0.8, 0.8]])] * 6)
    assert emission(rim, diffuse=np.tile(light, 6)) == [LAMP, LAMP + 1]
    assert emission(rim, diffuse=np.tile(light, 6), reach=1) == []
