# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fallback values of unseen surfaces, which are the same wherever the estimate is used."""

import numpy as np
import pytest

from fipt_blender.core.light.cache import pool, unseen_points
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.reliability import PlaceColors, part_detail
from fipt_blender.core.material.seen import RESOLUTION, Box, fallback_values, room_box, seen_cells, seen_statistics
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


def test_points_far_from_the_few_seen_ones_take_the_nearest_value():
    """A scan of a whole building of which a corner was photographed; here by one pixel, then by two."""
    for points in ([[1.0, 1.0, 1.0]], [[1.0, 1.0, 1.0], [1.0 + 1e-5, 1.0, 1.0]]):
        seen = np.array(points, np.float32)
        statistics = seen_statistics(seen, np.zeros(len(seen), int), seen, 2)
        far = np.array([[-300.0, 50.0, 4.0], [1.0, 1.0, 1.0], [2e3, 1e3, -5e2]], np.float32)
        values = fallback_values(far, np.ones(3, int), statistics)
        np.testing.assert_allclose(values, 1.0, atol=1e-4)


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
    assert error_of(RoomFields.load, run).code == "results-damaged"
    assert room_box((np.zeros(3), np.ones(3))).extent > 1.0
