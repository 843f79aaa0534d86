# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that nothing shows is found from what it does to floor and walls, near sources at their place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.capture.views import View
from fipt_blender.core.light.clipped import ON_LAMP, OUTSIDE, hemisphere_rays
from fipt_blender.core.light.environment import Environment, Hull
from fipt_blender.core.light.observations import Observations
from fipt_blender.core.light.radiance import OutsideRadiance
from fipt_blender.core.light.sources import Expectation, Transport, held_back_gain, solve_sources
from fipt_blender.core.light.unseen_light import with_unseen_light
from fipt_blender.core.pixels.store import open_pixels, trace_view
from fipt_blender.core.run.settings import Settings
from fipt_blender.core.surface.room import Room, triangle_normals
from samples.camera_poses import look_at
from samples.shading_points import grid_of
from samples.small_captures import CAMERAS, pinhole
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
    if len(room.triangles) == 12:
        ceiling[2 * CEILING : 2 * CEILING + 2] = 0
    entry, way = hemisphere_rays(room, grid_of(room), position, normal, ceiling, 5, 2048)
    reach = (3.0 - position[:, None, 2]) / np.maximum(way[..., 2], 1e-3)
    above = shines(position[:, None] + reach[..., None] * way)
    return np.where(((entry == OUTSIDE) | (entry == ON_LAMP))[..., None], above, INDIRECT).mean(axis=1)


def observations(folder: Path, room: Room, lit: bool = True) -> Observations:
    """Pixels of a diffuse room that no view shows the ceiling of, with a texture of a tenth."""
    views = [
        View(str(index), "train", Path("none"), **vars(pinhole(look_at(start, [*end[:2], 0.0]))))
        for index, (start, end) in enumerate(CAMERAS)
    ]
    pixels = open_pixels(folder, views, create=True)
    for index, view in enumerate(views):
        rows, traced = pixels.rows(index), trace_view(room, view)
        for name in ("position", "normal", "triangle", "front"):
            getattr(pixels, name)[rows] = getattr(traced, name)
    triangle = np.asarray(pixels.triangle)
    middle = room.vertices[room.triangles].mean(axis=1)
    pixels.triangle[:] = np.where(middle[triangle, 2] > 2.9, -1, triangle)
    hit = np.flatnonzero(np.asarray(pixels.triangle) >= 0)[::7]
    triangle = np.asarray(pixels.triangle[hit])
    normal = triangle_normals(room.vertices, room.triangles)[triangle]
    normal *= np.where(pixels.front[hit], 1.0, -1.0)[:, None]
    position = np.asarray(pixels.position[hit])
    irradiance = light(room, position, normal) if lit else np.full((len(hit), 3), INDIRECT)
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

    return Shown(pixels, None, grid, entry, None, 0.02, folder)  # type: ignore[arg-type]


def found_light(observed: Observations, room: Room) -> Observations:
    normals = triangle_normals(room.vertices, room.triangles)
    label = np.unique(np.round(normals), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)
    return with_unseen_light(observed, room, label, replace(Settings(), environment_width=32))


@pytest.mark.parametrize("quads", [[BOX[0], *BOX[2:]], BOX], ids=["no ceiling", "unseen ceiling"])
def test_a_lamp_that_no_view_shows_is_found_at_its_place(tmp_path: Path, quads: list) -> None:
    room = make_room(quads)
    found = found_light(observations(tmp_path, room), room).environment
    assert found is not None and found.unseen is not None and found.hull is not None
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
    if len(quads) == 6:
        assert found.lamps, "an unseen surface that shines is offered as a lamp"
        disc = max(found.lamps, key=lambda lamp: sum(lamp["radiance"]) * lamp["radius"] ** 2)
        assert np.linalg.norm(np.array(disc["position"]) - [*CORNER, 2.9]) < 0.6
        assert disc["facing"] == [0.0, 0.0, -1.0] and 0.3 < disc["radius"] < 0.9
        power = disc["radius"] ** 2 * np.array(disc["radiance"])
        assert np.all(np.abs(np.log(power / (LAMP / np.pi))) < 0.5), power


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
    np.testing.assert_allclose(np.exp(found.log_albedo), ALBEDO, rtol=0.1)
    share = (points.unseen @ radiance).sum(1) / (points.seen + points.unseen @ radiance).sum(1)
    assert np.abs(found.share(points) - share).mean() < 0.03
    assert 0.0 < found.error(points).max() < 0.2


def test_points_held_back_tell_light_from_noise() -> None:
    points, expected, _ = drawn_points(np.random.default_rng(3), 12)
    assert held_back_gain(points, expected, np.random.default_rng(0)) > 5.0
    rng = np.random.default_rng(5)
    light = points.seen + points.unseen @ np.exp(expected.log_radiance)
    dark = replace(points, log_radiance=np.log(ALBEDO[points.group] * light) + 0.3 * rng.normal(size=light.shape))
    assert held_back_gain(dark, expected, np.random.default_rng(0)) < 1.0
