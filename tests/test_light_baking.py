# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where in a pixel the samples of its shadings start, and denoising."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import SUBPIXELS, TriangleTables, denoised, samples_per_start, start_points
from fipt_blender.core.light.shadings import Shadings
from fipt_blender.core.pixels.store import fill_pixels, open_pixels
from fipt_blender.core.surface.room import Room
from samples.small_rooms import make_room

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
    store = open_pixels(tmp_path / "pixels", [view], create=True)
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


@pytest.mark.parametrize("samples", [4, 8, 16, 30, 64])
def test_all_starts_together_take_the_pixels_samples(samples: int) -> None:
    assert 0 <= samples_per_start(samples) * len(SUBPIXELS) - samples < len(SUBPIXELS)


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
