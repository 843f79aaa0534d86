"""Base colours of surfaces: fallbacks where nothing was seen, and patterns that stay as they are seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.cache import pool, unseen_points
from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.material.cell_errors import DrawnPixels
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.reliability import PlaceColors, part_detail, room_detail
from fipt_blender.core.material.seen import RESOLUTION, Box, room_box, seen_cells
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.refusals import error_of
from samples.shading_points import make_grid
from samples.small_rooms import BOX, make_room

BOX_4 = Box(np.zeros(3), 4.0)


class Ramp:
    """In place of the network: base colour, roughness and metallic are linear in x."""

    box = BOX_4

    def query(self, positions, units=None):
        x = (np.asarray(positions, np.float32)[:, 0] / 4.0).astype(np.float32)
        return np.stack([x, 0.5 * x, 0.2 * x, 1.0 - 0.5 * x, 0.1 * x], axis=1)


def grid_points(low: float, high: float, z: float, count: int = 40) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(low, high, count), np.linspace(0.1, 3.9, 4 * count))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1).astype(np.float32)


def units(triangle: list[int], single: bool = False) -> Units:
    return Units(np.array(triangle, np.int32), np.full(max(triangle) + 1, single))


@pytest.fixture
def fields() -> RoomFields:
    """Part 0 was seen up to x = 1, part 1 from x = 3, part 2 never. Triangle t is part t, triangle 3 none."""
    points = np.concatenate([grid_points(0.0, 1.0, 0.0), grid_points(3.0, 4.0, 0.0)])
    part = np.repeat([0, 1], len(points) // 2)
    cells = seen_cells(BOX_4, [(points[:99], part[:99]), (points[99:], part[99:])])
    certain = np.zeros((len(cells.keys), 3), np.float32)
    return RoomFields(Ramp(), units([0, 1, 2, -1]), cells, certain)


def test_seen_points_take_the_networks_values_and_unseen_ones_their_parts_median(fields):
    points = grid_points(0.05, 0.95, 0.0)
    on = lambda part: np.full(len(points), part)  # noqa: E731
    np.testing.assert_array_equal(np.column_stack(fields.query(points, on(0))), Ramp().query(points))
    assert (fields.confidence(points, on(0)) == 1.0).all() and not fields.confidence(points, on(1)).any()
    color, roughness, metallic = fields.query(points, on(1))  # part 1 was seen at the other end
    assert np.ptp(color, axis=0).max() == 0.0
    middle = 3.5 / 4.0
    assert color[0] == pytest.approx([middle, 0.5 * middle, 0.2 * middle], abs=0.01)
    assert roughness[0] == pytest.approx(1.0 - 0.5 * middle, abs=0.01)
    assert metallic[0] == pytest.approx(0.1 * middle, abs=0.01)


def test_detail_that_is_not_reliable_goes_if_the_part_is_one_material(fields):
    points = grid_points(0.05, 0.95, 0.0)
    on, ones, exact = np.zeros(len(points), int), np.ones((2, len(points))), Ramp().query(points)[:, :3]
    plain = fields.query(points, on)
    median = np.array([np.median(exact, axis=0), [np.nan] * 3, [np.nan] * 3])
    contrary = 2.0 * median[0] - exact
    given = units([0, 1, 2, -1], True), fields.cells, fields.errors
    for other, least, most in ((exact, 0.9, 1.0), (contrary, 0.0, 0.0)):
        places = PlaceColors(points, on, exact, np.stack([exact, other]), ones, 0.0 * ones[0])
        rooms = RoomFields(Ramp(), *given, detail=part_detail(places, median, 0.03, BOX_4))
        shrunk = rooms.query(points, on)
        kept = np.ptp(shrunk[0], axis=0) / np.ptp(plain[0], axis=0)
        assert (kept >= least).all() and (kept <= most).all()
        # One roughness and metallic, whatever is kept of base colour.
        assert np.ptp(shrunk[1]) == np.ptp(shrunk[2]) == 0.0 < np.ptp(plain[1])
        # What no photograph shows of the part has the same median.
        unseen = rooms.query(points + np.float32([2.0, 0.0, 0.0]), on)[0]
        np.testing.assert_allclose(unseen, np.broadcast_to(median[0], unseen.shape), atol=1e-6)


def test_a_doubtful_place_lowers_confidence_and_blurs_nothing(fields):
    points = grid_points(0.05, 0.95, 0.0)
    on = np.zeros(len(points), int)
    errors = np.full_like(fields.errors, 0.001)
    exact, fine, coarse = (
        RoomFields(Ramp(), units([0, 1, 2, -1], True), fields.cells, errors, place) for place in (0.0, 0.01, 0.02)
    )
    for one, other in zip(exact.query(points, on), coarse.query(points, on), strict=True):
        np.testing.assert_array_equal(one, other)
    certain, less, least = (each.confidence(points, on)[:, 0] for each in (exact, fine, coarse))
    assert (least < less - 0.05).all() and (less < certain - 0.1).all()


@pytest.mark.parametrize("triangle", [2, 3])
def test_unseen_parts_and_triangles_without_part_take_the_nearest_seen_point(fields, triangle):
    points = np.array([[1.4, 2.0, 0.0], [2.6, 2.0, 0.0]], np.float32)
    color, _, _ = fields.query(points, np.full(2, triangle))
    assert color[:, 0] == pytest.approx([1.0 / 4.0, 3.0 / 4.0], abs=0.03)


def test_neighbours_of_a_seen_cell_count_as_seen(fields):
    cell = 4.0 / RESOLUTION
    points = np.array([[1.0 + 0.9 * cell, 2.0, 0.0], [1.0 + 2.5 * cell, 2.0, 0.0]], np.float32)
    assert fields.confidence(points, np.zeros(2, int)).all(axis=1).tolist() == [True, False]


def test_without_any_seen_surface_the_networks_values_remain():
    nothing = seen_cells(BOX_4, [(np.zeros((0, 3), np.float32), np.zeros(0, np.int32))])
    points = grid_points(0.0, 4.0, 0.0)
    values = RoomFields(Ramp(), units([0]), nothing).query(points, np.zeros(len(points), int))
    np.testing.assert_array_equal(values[0], Ramp().query(points)[:, :3])


def test_refinement_has_a_point_for_every_entry_without_pixels():
    room = make_room(BOX)
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-2, 2, (4000, 2)), np.zeros(4000)]).astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (4000, 1))
    grid = make_grid(room, floor, up, 24, rng)
    count = pool(grid, grid.entries(floor, up), floor)[1]
    entries, points, triangles = unseen_points(grid, room, count, rng)
    assert (count[entries] == 0).all() and len(np.unique(entries)) == len(entries)
    assert (triangles[points[:, 2] > 2.99] >= 2).all()  # points of the ceiling lie on no floor triangle
    # Both sides of five walls and the floor's underside, of about 22 x 22 or 22 x 16 voxels each.
    assert 3000 < len(entries) < 8000


def test_missing_and_damaged_results_raise(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.create(make_settings())
    run.results.mkdir(exist_ok=True)
    np.savez(run.fields_npz, box_extent=1.0)
    assert error_of(RoomFields.load, run).code == "results-missing"
    np.savez(run.parts_npz, triangle_part=np.zeros(2, np.int32))
    assert error_of(RoomFields.load, run).code == "file-damaged"
    assert room_box((np.zeros(3), np.ones(3))).extent > 1.0


SIDE, PIXEL = 64, 0.02  # places along a wall, and their width in metres
WALL = Box(np.zeros(3) - 0.1, 4.0)
VIEWS, SEES = 8, 0.7  # the views, and the share of them that sees a place
TINT = np.array([1.0, 0.9, 0.75])
# Relative errors of base colour: noise of the pixels, errors of a view that are alike over 3 and over 15
# pixels, errors of light that all views have in common, alike over 12 pixels.
NOISE, NEAR, FAR, LIGHT = 0.03, 0.015, 0.02, 0.01
KINDS = ("lines", "dots", "print", "grain")


def pattern(kind: str, width: int, rng: np.random.Generator) -> np.ndarray:
    """(SIDE, SIDE) where a pattern is dark (1) and where not (0), or in between; `width` in places."""
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    if kind == "lines":
        return ((column // width) % 3 == 0).astype(float)
    if kind == "dots":
        return (((column // width) % 3 == 0) & ((row // width) % 3 == 0)).astype(float)
    if kind == "print":  # words of random length in lines of text
        words = np.repeat(rng.random((SIDE, SIDE)) < 0.6, width, axis=0)[:SIDE]
        words = np.repeat(words, width, axis=1)[:, :SIDE]
        return (words & ((row // width) % 2 == 0)).astype(float)
    blocks = rng.random((SIDE, SIDE)).repeat(width, axis=0).repeat(width, axis=1)
    return blocks[:SIDE, :SIDE]  # grain


def smooth(rng: np.random.Generator, width: float) -> np.ndarray:
    """(SIDE, SIDE) random field with a standard deviation of 1 that is alike over `width` places."""
    field = gaussian_filter(rng.normal(size=(SIDE, SIDE)), width)
    return (field - np.median(field)) / field.std()


def seen(true: np.ndarray, rng: np.random.Generator, light: float = 1.0) -> tuple[PlaceColors, np.ndarray]:
    """A wall of these base colours (SIDE, SIDE, 3) as the views show it, and (K, 3) the truth at its places.

    Args:
        light: factor of the error of light that all views share.
    """
    common = 1.0 + light * LIGHT * smooth(rng, 12.0)
    errors = [NEAR * smooth(rng, 3.0) + FAR * smooth(rng, 15.0) + NOISE * smooth(rng, 0.0) for _ in range(VIEWS)]
    views = (true * (common + np.array(errors))[..., None]).reshape(VIEWS, -1, 3)
    sees = rng.random(views.shape[:2]) < SEES
    kept = sees.any(axis=0)
    weight = np.stack([sees[0::2].sum(axis=0), sees[1::2].sum(axis=0)]).astype(float)[:, kept]
    sums = (views * sees[..., None]).reshape(-1, 2, *views.shape[1:]).sum(axis=0)[:, kept]
    row, column = np.divmod(np.flatnonzero(kept), SIDE)
    position = PIXEL * np.stack([column + 0.5, row + 0.5, np.zeros(len(row))], axis=1)
    # Standard errors come from the spread between views, half of which is taken as common to all.
    error = np.hypot(LIGHT, np.hypot(NEAR, FAR) / np.sqrt(SEES * VIEWS)) * np.median(true)
    halves = sums / np.maximum(weight, 1.0)[..., None]
    color = sums.sum(axis=0) / weight.sum(axis=0)[:, None]
    part = np.zeros(len(row), int)
    places = PlaceColors(position, part, color, halves, weight, np.full(len(row), error))
    return places, true.reshape(-1, 3)[kept]


def as_parts(walls: list[PlaceColors]) -> PlaceColors:
    along = {"halves": 1, "weight": 1}
    joined = {
        name: np.concatenate([getattr(wall, name) for wall in walls], axis=along.get(name, 0))
        for name in ("position", "color", "halves", "weight", "error")
    }
    return PlaceColors(part=np.repeat(np.arange(len(walls)), [len(wall.part) for wall in walls]), **joined)


def shrunk(walls: list[PlaceColors]) -> list[np.ndarray]:
    """What becomes of the estimate at the places of each wall."""
    places = as_parts(walls)
    median = np.stack([np.median(wall.color, axis=0) for wall in walls])
    detail = part_detail(places, median, PIXEL, WALL)
    values = detail.shrink(places.color, places.position, places.part, WALL)
    return np.split(values, np.flatnonzero(np.diff(places.part)) + 1)


def psnr(values: np.ndarray, true: np.ndarray) -> float:
    return float(-10.0 * np.log10(((values - true) ** 2).mean()))


def correlation(values: np.ndarray, true: np.ndarray) -> float:
    values, true = values - values.mean(axis=0), true - true.mean(axis=0)
    return float((values * true).sum() / np.sqrt((values**2).sum() * (true**2).sum() + 1e-30))


@pytest.mark.parametrize(("kind", "width"), [("lines", 1), ("dots", 2), ("dots", 5), ("print", 3), ("grain", 1)])
def test_patterns_stay_and_paint_beside_them_is_one_colour(kind: str, width: int) -> None:
    rng = np.random.default_rng([width, KINDS.index(kind)])
    cases = [(0.08, 0.0), (0.7, 0.0), (0.7, 0.05), (0.08, 0.1), (0.7, 0.3)]
    made = [
        seen(bright * TINT * (1.0 - contrast * pattern(kind, width, rng)[..., None]), rng) for bright, contrast in cases
    ]
    values = shrunk([places for places, _ in made])
    for (_, contrast), (places, true), result in zip(cases, made, values, strict=True):
        flat, single = psnr(np.median(places.color, axis=0), true), psnr(places.color, true)
        found = psnr(result, true)
        if contrast == 0.0:
            assert found > 45.0
            continue
        # Never worse than both, nor much worse than the better one of a pattern as weak as the errors.
        assert found > max(min(flat, single) - 0.1, max(flat, single) - 2.0)
        if contrast >= 0.1:
            assert found > 0.95 * single
            assert correlation(result, true) > 0.95 * correlation(places.color, true)


@pytest.mark.parametrize("height", [0.01, 0.02, 0.035])
def test_a_blotch_of_wrong_light_near_a_lamp_is_gone(height: float) -> None:
    places, _ = seen(np.full((SIDE, SIDE, 3), 0.6) * TINT, np.random.default_rng(4))
    away = ((places.position[:, :2] - [0.4, 0.8]) ** 2).sum(axis=1)
    blotch = height * np.exp(-0.5 * away / 0.15**2)[:, None]
    doubted = replace(
        places,
        color=places.color + blotch,
        halves=places.halves + blotch,
        error=np.hypot(places.error, blotch[:, 0]),  # as lamp_doubt says
    )
    assert psnr(shrunk([doubted])[0], np.median(doubted.color, axis=0)) > 50.0


def test_a_picture_on_a_wall_stays_and_the_wall_beside_it_is_plainer() -> None:
    true = np.full((SIDE, SIDE, 3), 0.7) * TINT
    rng = np.random.default_rng(5)
    true[10:24, 12:30] = [0.2, 0.3, 0.25] * (1.0 - 0.3 * pattern("print", 2, rng)[10:24, 12:30, None])
    places, true = seen(true.reshape(SIDE, SIDE, 3), rng)
    (values,) = shrunk([places])
    column, row = (places.position[:, :2] / PIXEL).T.astype(int)
    picture = (row >= 10) & (row < 24) & (column >= 12) & (column < 30)
    far = (row >= 44) | (column >= 50)
    wall = np.median(places.color, axis=0)
    kept = (values[picture].mean(axis=0) - wall) / (places.color[picture].mean(axis=0) - wall)
    assert (kept > 0.95).all() and (kept < 1.02).all()
    assert correlation(values[picture], true[picture]) > 0.95 * correlation(places.color[picture], true[picture])
    assert psnr(values[far], true[far]) > psnr(places.color[far], true[far]) + 2.0


@pytest.mark.parametrize("moved", [0, 1, 2])
def test_a_poster_stays_where_poses_and_light_of_the_whole_room_are_wrong(moved: int) -> None:
    """As in a scan: standard errors are as large as what the poster shows, and the halves are displaced."""
    rng = np.random.default_rng(8)
    poster = 0.7 * TINT * (1.0 - 0.4 * pattern("print", 3, rng)[..., None])
    walls = [seen(poster, rng)[0], seen(np.full((SIDE, SIDE, 3), 0.7) * TINT, rng)[0]]
    halves = walls[0].halves.copy()
    halves[1] = halves[1].reshape(SIDE, SIDE, 3)[:, np.arange(SIDE) - moved].reshape(-1, 3)
    wrong = [replace(wall, error=0.0 * wall.error + 0.1) for wall in (replace(walls[0], halves=halves), walls[1])]
    values = shrunk(wrong)[0]
    assert values.std(axis=0).mean() > 0.9 * walls[0].color.std(axis=0).mean()
    assert correlation(values, walls[0].color) > 0.95


def test_detail_that_no_other_photograph_could_repeat_stays_above_the_noise_of_the_room() -> None:
    rng = np.random.default_rng(6)
    known, _ = seen(np.full((SIDE, SIDE, 3), 0.6) * TINT, rng)
    one_half = [seen(0.6 * TINT * (1.0 - c * pattern("print", 3, rng)[..., None]), rng) for c in (0.4, 0.0)]
    walls = [replace(places, weight=places.weight * [[1.0], [0.0]]) for places, _ in one_half]
    _, picture, plain = shrunk([known, *walls])
    (places, true), (noisy, _) = one_half
    assert picture.std(axis=0).mean() > 0.9 * places.color.std(axis=0).mean()
    assert correlation(picture, true) > 0.95
    assert plain.std(axis=0).mean() < 0.7 * noisy.color.std(axis=0).mean()


class PlaceByPlace:
    """In place of the network: a base colour for each place of a wall (SIDE, SIDE, 3), rough, no metal."""

    box = WALL

    def __init__(self, color: np.ndarray) -> None:
        self.color = color

    def query(self, positions: np.ndarray, units: np.ndarray) -> np.ndarray:
        column, row = (positions[:, :2] / PIXEL).astype(int).T
        return np.column_stack([self.color[row, column], np.ones(len(row)), np.zeros(len(row))])


@pytest.mark.parametrize("contrast", [0.0, 0.2])
def test_the_halves_are_made_of_the_pixels_of_the_views(contrast: float) -> None:
    """Photographs of a wall in light that differs from view to view; a part of several materials stays."""
    rng = np.random.default_rng(7)
    true = 0.6 * TINT * (1.0 - contrast * pattern("dots", 2, rng)[..., None])
    row, column = (index.ravel() for index in np.mgrid[0:SIDE, 0:SIDE])
    points = PIXEL * np.stack([column + 0.5, row + 0.5, np.zeros(len(row))], axis=1).astype(np.float32)
    light = np.linspace(0.5, 2.0, VIEWS)[:, None, None] * np.ones((1, SIDE**2, 3))
    noise = np.stack([FAR * smooth(rng, 15.0) + NOISE * smooth(rng, 0.0) for _ in range(VIEWS)])
    shown = true.reshape(-1, 3) * (1.0 + noise.reshape(VIEWS, -1, 1))
    fields, part = PlaceByPlace(shown.mean(axis=0).reshape(true.shape)), (row >= SIDE // 2).astype(int)
    units = Units(np.arange(2, dtype=np.int32), np.array([True, False]))
    cells = seen_cells(WALL, [(points, part)])
    count, levels = VIEWS * SIDE**2, roughness_levels(2, 0.1, 1.0)
    specular = np.zeros((count, len(levels), 2, 3), np.float16)
    shadings = ShadingStore(light.reshape(-1, 3).astype(np.float16), specular, levels)
    view = np.repeat(2 * np.arange(VIEWS), SIDE**2)  # those of odd number see other parts
    pixels = SimpleNamespace(own=(shown * light).reshape(-1, 3), view_of=lambda rows: view[rows])
    seen_by = SimpleNamespace(pixels=pixels, footprint=PIXEL)
    data = SimpleNamespace(observations=seen_by, shadings=shadings)
    position, unit = np.tile(points, (VIEWS, 1)), np.tile(part, VIEWS)
    found, place = np.unique(cells.find(WALL, position, unit), return_inverse=True)
    drawn = DrawnPixels(np.arange(count), position, unit, found, place)
    errors = np.full((len(cells.keys), 3), 0.022, np.float32)
    detail = room_detail(drawn, data, units, fields, cells, errors)
    values = detail.shrink(fields.query(points, part)[:, :3], points, part, WALL)
    one, truth = part == 0, true.reshape(-1, 3)
    estimate = fields.color.reshape(-1, 3)
    np.testing.assert_allclose(values[~one], estimate[~one], atol=1e-6)
    if contrast:
        assert psnr(values[one], truth[one]) > psnr(estimate[one], truth[one]) - 0.5
    else:
        assert np.ptp(values[one], axis=0).max() == 0.0 < np.ptp(estimate[one], axis=0).min()
        assert psnr(values[one], truth[one]) > 50.0
