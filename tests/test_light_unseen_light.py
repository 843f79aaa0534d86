# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that enters a box without a ceiling is found from what it does to floor and walls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.views import View
from fipt_blender.core.conventions import equirect_pixel_directions
from fipt_blender.core.light.clipped import OUTSIDE, hemisphere_rays
from fipt_blender.core.light.environment import Environment
from fipt_blender.core.light.unseen_light import (
    PARTS,
    OpenPoints,
    seen_sky,
    sky_parts,
    solve_sky,
    with_unseen_light,
)
from fipt_blender.core.pixels.store import PixelStore, open_pixels, trace_view
from fipt_blender.core.surface.room import Room, triangle_normals
from samples.camera_poses import look_at
from samples.shading_points import grid_of
from samples.small_captures import CAMERAS, pinhole
from samples.small_rooms import BOX, make_room

OPEN_BOX = make_room([BOX[0], *BOX[2:]])
ALBEDO = np.array([[0.4, 0.4, 0.4], [0.7, 0.7, 0.7], [0.5, 0.1, 0.1], [0.6, 0.5, 0.4], [0.25, 0.3, 0.35]])
INDIRECT = 0.5  # radiance of all surfaces as the cache has it
WIDTH = 32


def sky(directions: np.ndarray, seed: int) -> np.ndarray:
    """(..., 3) radiance: dim, with a bright lamp somewhere above."""
    lamp = np.array([0.3, -0.2, 1.0]) if seed == 0 else np.array([-0.5, 0.4, 1.0])
    cosine = directions @ (lamp / np.linalg.norm(lamp))
    return (1.0 + 30.0 * np.exp(12.0 * (cosine - 1.0)))[..., None] * np.array([1.1, 1.0, 0.9])


def light(room: Room, position: np.ndarray, normal: np.ndarray, of) -> np.ndarray:
    """(N, 3) irradiance over pi; `of` maps directions to the radiance from outside."""
    nothing = np.full(len(room.triangles), -1, np.int32)
    entry, direction = hemisphere_rays(room, grid_of(room), position, normal, nothing, 5)
    return np.where((entry == OUTSIDE)[..., None], of(direction), INDIRECT).mean(axis=1)


def photographs(folder: Path, room: Room, seed: int) -> PixelStore:
    """Pixels of a diffuse room under the sky, whose texture varies by a tenth."""
    views = [
        View(str(index), "train", Path("none"), **vars(pinhole(look_at(*CAMERAS[index]))))
        for index in range(6)
    ]
    pixels = open_pixels(folder, views, create=True)
    for index, view in enumerate(views):
        rows, traced = pixels.rows(index), trace_view(room, view)
        for name in ("position", "normal", "triangle", "front"):
            getattr(pixels, name)[rows] = getattr(traced, name)
    hit = np.flatnonzero(np.asarray(pixels.triangle) >= 0)
    triangle = np.asarray(pixels.triangle[hit])
    side = np.where(pixels.front[hit], 1.0, -1.0)[:, None]
    normal = triangle_normals(room.vertices, room.triangles)[triangle] * side
    irradiance = light(room, np.asarray(pixels.position[hit]), normal, lambda ways: sky(ways, seed))
    texture = np.exp(np.random.default_rng(seed).normal(0.0, 0.1, (len(hit), 1)))
    pixels.own[hit] = ALBEDO[triangle // 2 % 5] * irradiance * texture
    pixels.pure[:], pixels.weight[:] = pixels.triangle >= 0, 1.0
    return pixels


def found_light(pixels: PixelStore, room: Room, environment: Environment | None) -> Environment | None:
    grid = grid_of(room)
    cache = np.full((len(grid.voxels) * 6, 3), INDIRECT, np.float32)
    label = (np.arange(len(room.triangles)) // 2).astype(np.int32)
    return with_unseen_light(environment, pixels, room, grid, lambda: cache, label, WIDTH, 0)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_sky_above_an_open_box_is_found(tmp_path: Path, seed: int) -> None:
    pixels = photographs(tmp_path, OPEN_BOX, seed)
    found = found_light(pixels, OPEN_BOX, None)
    assert found is not None and not found.seen.any() and found.observed_share == 0.0
    floor = np.array([[x, y, 0.01] for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)])
    up = np.tile([0.0, 0.0, 1.0], (len(floor), 1))
    directions = equirect_pixel_directions(WIDTH, WIDTH // 2).reshape(-1, 3)

    def by_map(ways: np.ndarray) -> np.ndarray:
        nearest = (ways.reshape(-1, 3) @ directions.T).argmax(axis=1)
        return found.image.reshape(-1, 3)[nearest].reshape(ways.shape)

    true = light(OPEN_BOX, floor, up, lambda ways: sky(ways, seed))
    ratio = np.log(light(OPEN_BOX, floor, up, by_map) / true)
    even = np.log(light(OPEN_BOX, floor, up, np.ones_like) / true)
    assert np.abs(ratio.mean()) < 0.6  # five albedos tell the level of light roughly
    # How it falls on the floor is clear, although parts of the sky are wider than the lamp.
    assert ratio.std(axis=0).max() < 0.5 * even.std(axis=0).min(), (ratio.std(axis=0), even.std(axis=0))


def test_what_was_seen_outside_stays(tmp_path: Path) -> None:
    pixels = photographs(tmp_path, OPEN_BOX, 0)
    seen = np.zeros((WIDTH // 2, WIDTH), bool)
    seen[6:9] = True
    before = Environment(np.full((*seen.shape, 3), 3.0, np.float32), 0.3, seen)
    found = found_light(pixels, OPEN_BOX, before)
    assert found is not None and found.observed_share == 0.3
    assert (found.image[seen] == 3.0).all() and (found.image[~seen] != 3.0).all()


def test_noise_of_the_light_is_no_sky_where_it_is_dark_outside() -> None:
    """Noise of the light seems less beside a bright sky; photographs of the outside tell better."""
    rng = np.random.default_rng(3)
    count = 1500
    group = np.arange(count) % len(ALBEDO)
    true = np.exp(rng.normal(0.0, 0.5, (count, 1))) * np.array([1.0, 0.9, 0.8])
    noisy = true * np.exp(rng.normal(0.0, 0.4, (count, 1)))
    unseen = 0.2 * rng.random((count, 1)) * rng.dirichlet(np.full(PARTS, 0.3), count)
    points = OpenPoints(np.log(ALBEDO[group] * true), group, noisy, unseen)
    image, known = np.zeros((WIDTH // 2, WIDTH, 3)), np.zeros((WIDTH // 2, WIDTH), bool)

    def share(sky: np.ndarray) -> float:
        cast = unseen @ sky
        return float((cast.sum(axis=1) / (noisy + cast).sum(axis=1)).mean())

    assert share(solve_sky(points, seen_sky(image, known))) > 0.05
    known[6:9] = True
    assert share(solve_sky(points, seen_sky(image, known))) < 0.01


def test_parts_that_photographs_show_have_their_brightness() -> None:
    radiance = np.array([3.0, 2.0, 1.0])
    image = np.broadcast_to(radiance, (WIDTH // 2, WIDTH, 3))
    known = np.ones(image.shape[:2], bool)
    level, share = seen_sky(image, known)
    np.testing.assert_allclose(level, np.log(radiance).mean())
    np.testing.assert_allclose(share, 1.0)
    known[WIDTH // 4 :] = False  # below the horizon
    upper = sky_parts(np.array([[0.0, 0.0, 1.0]]))[0].argmax()
    share = seen_sky(image, known)[1]
    assert share[upper] > 0.9 and share.min() < 0.1 and abs(share.mean() - 0.5) < 0.02


def test_a_closed_room_has_the_environment_that_was_seen(tmp_path: Path) -> None:
    room = make_room(BOX)
    pixels = photographs(tmp_path, room, 0)
    seen = np.zeros((WIDTH // 2, WIDTH), bool)
    seen[6:9] = True
    before = Environment(np.full((*seen.shape, 3), 3.0, np.float32), 0.3, seen)
    assert found_light(pixels, room, before) is before
    assert found_light(pixels, room, None) is None


def test_parts_of_the_sky_sum_to_one() -> None:
    weight = sky_parts(equirect_pixel_directions(64, 32).reshape(-1, 3))
    np.testing.assert_allclose(weight.sum(axis=1), 1.0)
    assert (weight > 0.0).all()
