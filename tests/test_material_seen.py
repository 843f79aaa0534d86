# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Base colours of surfaces: fallbacks where nothing was seen, and patterns that stay as they are seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fipt_blender.core.light.cache import pool, unseen_points
from fipt_blender.core.material.cell_errors import DrawnPixels
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.reliability import part_detail, room_detail
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
    on, exact = np.zeros(len(points), int), Ramp().query(points)[:, :3]
    plain = fields.query(points, on)
    median = np.array([np.median(exact, axis=0), [np.nan] * 3, [np.nan] * 3])
    rooms = RoomFields(
        Ramp(), units([0, 1, 2, -1], True), fields.cells, fields.errors,
        detail=part_detail(points, on, exact, median, 0.03, BOX_4),
    )  # fmt: skip
    shrunk = rooms.query(points, on)
    kept = np.ptp(shrunk[0], axis=0) / np.ptp(plain[0], axis=0)
    assert (kept >= 0.9).all() and (kept <= 1.0).all()  # a slope far above any error
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
VIEWS = 8
TINT = np.array([1.0, 0.9, 0.75])
# Relative errors of base colour: noise of the pixels, errors of a view that are alike over 3 and over 15
# pixels, errors of light that all views have in common, alike over 12 pixels.
NOISE, NEAR, FAR, LIGHT = 0.03, 0.015, 0.02, 0.01
KINDS = ("lines", "dots", "print", "grain")
ROW, COLUMN = (index.ravel() for index in np.mgrid[0:SIDE, 0:SIDE])
POINTS = PIXEL * np.stack([COLUMN + 0.5, ROW + 0.5, np.zeros(len(ROW))], axis=1).astype(np.float32)


def pattern(kind: str, width: int, rng: np.random.Generator) -> np.ndarray:
    """(SIDE, SIDE, 1) where a pattern is dark (1) and where not (0), or in between; `width` in places."""
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    if kind == "lines":
        dark = (column // width) % 3 == 0
    elif kind == "dots":
        dark = ((column // width) % 3 == 0) & ((row // width) % 3 == 0)
    else:
        blocks = rng.random((SIDE, SIDE)).repeat(width, axis=0).repeat(width, axis=1)[:SIDE, :SIDE]
        # Words of random length in lines of text, or grain.
        dark = (blocks < 0.6) & ((row // width) % 2 == 0) if kind == "print" else blocks
    return dark.astype(float)[..., None]


def smooth(rng: np.random.Generator, width: float) -> np.ndarray:
    """(SIDE, SIDE) random field with a standard deviation of 1 that is alike over `width` places."""
    field = gaussian_filter(rng.normal(size=(SIDE, SIDE)), width)
    return (field - np.median(field)) / field.std()


def seen(true: np.ndarray, rng: np.random.Generator, factor: float = 1.0, displaced: float = 0.0) -> np.ndarray:
    """(SIDE, SIDE, 3) the estimate of a wall of these base colours.

    Args:
        factor: of the errors. displaced: standard deviation of the views' places, in pixels.
    """
    views = []
    for _ in range(VIEWS):
        error = NEAR * smooth(rng, 3.0) + FAR * smooth(rng, 15.0) + NOISE * smooth(rng, 0.0)
        moved = np.roll(true, np.rint(displaced * rng.normal(size=2)).astype(int), axis=(0, 1))
        views.append(moved * (1.0 + factor * error)[..., None])
    return np.mean(views, axis=0) * (1.0 + factor * LIGHT * smooth(rng, 12.0))[..., None]


def shrunk(walls: list[np.ndarray]) -> list[np.ndarray]:
    """What becomes of the estimates of walls (SIDE, SIDE, 3), each of which is a part."""
    color = [wall.reshape(-1, 3) for wall in walls]
    part, points = np.repeat(np.arange(len(walls)), SIDE**2), np.tile(POINTS, (len(walls), 1))
    median = np.stack([np.median(each, axis=0) for each in color])
    detail = part_detail(points, part, np.concatenate(color), median, PIXEL, WALL)
    return list(detail.shrink(np.concatenate(color), points, part, WALL).reshape(-1, SIDE, SIDE, 3))


def psnr(values: np.ndarray, true: np.ndarray) -> float:
    return float(-10.0 * np.log10(((values - true) ** 2).mean()))


def correlation(values: np.ndarray, true: np.ndarray) -> float:
    values, true = values - values.mean(axis=(0, 1)), true - true.mean(axis=(0, 1))
    return float((values * true).sum() / np.sqrt((values**2).sum() * (true**2).sum() + 1e-30))


@pytest.mark.parametrize(("kind", "width"), [("lines", 1), ("dots", 2), ("dots", 5), ("print", 3), ("grain", 1)])
def test_patterns_stay_and_paint_beside_them_is_plainer(kind: str, width: int) -> None:
    rng = np.random.default_rng([width, KINDS.index(kind)])
    cases = [(0.08, 0.0), (0.7, 0.0), (0.6, 0.0), (0.5, 0.0), (0.08, 0.1), (0.7, 0.1), (0.7, 0.3)]
    true = [bright * TINT * (1.0 - contrast * pattern(kind, width, rng)) for bright, contrast in cases]
    estimates = [seen(wall, rng) for wall in true]
    for (bright, contrast), wall, estimate, result in zip(cases, true, estimates, shrunk(estimates), strict=True):
        plain = psnr(np.median(estimate, axis=(0, 1)), wall)
        print(kind, width, bright, contrast, plain, psnr(estimate, wall), psnr(result, wall))
        if not contrast:
            assert psnr(result, wall) > psnr(estimate, wall) + 2.0
        elif bright * contrast >= 0.05:
            assert psnr(result, wall) > psnr(estimate, wall) - 0.3
            assert correlation(result, wall) > 0.97 * correlation(estimate, wall)


def test_a_room_of_errors_and_displaced_views_keeps_what_is_plainly_visible() -> None:
    """A scan's room: light is wrong everywhere, and photographs show a poster at places some pixels apart."""
    rng = np.random.default_rng(5)
    poster = np.full((SIDE, SIDE, 3), 0.7) * TINT
    poster[10:40, 12:50] *= 1.0 - 0.8 * pattern("print", 3, rng)[10:40, 12:50]
    walls = [seen(true, rng, 4.0, 1.5) for true in (poster, 0.7 * TINT + 0.0 * poster, 0.3 * TINT + 0.0 * poster)]
    for wall, result in zip(walls, shrunk(walls), strict=True):
        print(psnr(result, wall), result.std() / wall.std())
        assert psnr(result, wall) > 36.0
    assert correlation(shrunk(walls)[0], walls[0]) > 0.99


class PlaceByPlace:
    """In place of the network: a base colour for each place of a wall (SIDE, SIDE, 3), rough, no metal."""

    box = WALL

    def __init__(self, color: np.ndarray) -> None:
        self.color = color

    def query(self, positions: np.ndarray, units: np.ndarray) -> np.ndarray:
        column, row = (positions[:, :2] / PIXEL).astype(int).T
        return np.column_stack([self.color[row, column], np.ones(len(row)), np.zeros(len(row))])


def test_places_are_those_of_the_pixels_and_a_part_of_several_materials_stays() -> None:
    shown = seen(0.6 * TINT * np.ones((SIDE, SIDE, 1)), np.random.default_rng(7))
    fields, part = PlaceByPlace(shown), (ROW >= SIDE // 2).astype(int)
    cells = seen_cells(WALL, [(POINTS, part)])
    position, unit = np.tile(POINTS, (VIEWS, 1)), np.tile(part, VIEWS)
    found, place = np.unique(cells.find(WALL, position, unit), return_inverse=True)
    drawn = DrawnPixels(np.arange(len(unit)), position, unit, found, place)
    errors = np.full((len(cells.keys), 3), 0.022, np.float32)
    both = Units(np.arange(2, dtype=np.int32), np.array([True, False]))
    estimate = shown.reshape(-1, 3)
    values = room_detail(drawn, PIXEL, both, fields, cells, errors).shrink(estimate, POINTS, part, WALL)
    np.testing.assert_allclose(values[part == 1], estimate[part == 1], atol=1e-6)
    assert values[part == 0].std(axis=0).mean() < 0.7 * estimate[part == 0].std(axis=0).mean()
    several = replace(both, single=np.zeros(2, bool))
    assert room_detail(drawn, PIXEL, several, fields, cells, errors) is None
