# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixed pixels are found at edges of depth, slope and parts, and take the radiance of a pure neighbour."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.environment import outside_pixels
from fipt_blender.core.pixels.mixed_pixels import find_donors, mark_pure
from fipt_blender.core.pixels.store import LEFT_OUT, NO_TRIANGLE, PixelStore, fill_pixels, open_pixels
from samples.small_rooms import make_room

WIDTH, HEIGHT = 16, 12


def floor_camera(image: Path) -> View:
    """A camera that looks straight down at the origin from two metres: a pixel is 0.1 m wide on the floor."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.0, 0.0, 2.0]
    return View("train/0", "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


@pytest.fixture
def two_parts(tmp_path: Path) -> tuple[PixelStore, np.ndarray]:
    """A floor of two coplanar halves that meet at x = 0.03: inside a column of pixels."""
    image = tmp_path / "image.exr"
    write_exr(image, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    room = make_room(
        [[[-3, -3, 0], [0.03, -3, 0], [0.03, 3, 0], [-3, 3, 0]], [[0.03, -3, 0], [3, -3, 0], [3, 3, 0], [0.03, 3, 0]]]
    )
    store = open_pixels(tmp_path / "pixels", [floor_camera(image)], create=True)
    assert fill_pixels(store, room, lambda done: None) == pytest.approx(0.5)
    mark_pure(store, room, np.array([0, 0, 1, 1]), lambda done: None)
    return store, np.array([0, 0, 1, 1])[store.triangle]


def test_pixels_across_a_border_of_parts_are_mixed(two_parts: tuple[PixelStore, np.ndarray]) -> None:
    pure = np.asarray(two_parts[0].pure).reshape(HEIGHT, WIDTH)
    assert not pure[:, 8].any()  # the column over x = 0 to 0.1 m
    assert pure[:, :8].all() and pure[:, 9:].all()


def test_a_mixed_pixel_takes_a_donor_of_its_own_part(two_parts: tuple[PixelStore, np.ndarray]) -> None:
    store, part = two_parts
    donors = find_donors(store, 0, part, 2).reshape(HEIGHT, WIDTH)
    own = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    assert (part.reshape(HEIGHT, WIDTH)[:, 8] == 1).all()  # its centre lies on the right half
    assert (donors[:, 8] == own[:, 9]).all()
    assert (np.delete(donors, 8, axis=1) == np.delete(own, 8, axis=1)).all()
    # No pixel of another part, beyond the image's border or out of reach is a donor.
    alone = np.where(np.arange(WIDTH * HEIGHT) % WIDTH == 8, 7, 0)
    assert (find_donors(store, 0, alone, 4).reshape(HEIGHT, WIDTH)[:, 8] == -1).all()
    assert (find_donors(store, 0, part, 0).reshape(HEIGHT, WIDTH)[:, 8] == -1).all()


def test_masked_pixels_are_neither_room_nor_outside(tmp_path: Path) -> None:
    """The left half is masked; its glare must not affect the scale, the pixels or the environment."""
    image, mask = tmp_path / "image.exr", tmp_path / "mask.exr"
    pixels = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    pixels[:, :8] = 1000.0
    write_exr(image, pixels)
    ids = np.ones((HEIGHT, WIDTH), np.float32)
    ids[:, :8] = 0.0
    write_exr(mask, ids)
    room = make_room([[[-3, -3, 0], [3, -3, 0], [3, 0.3, 0], [-3, 0.3, 0]]])  # the upper rows look outside
    store = open_pixels(tmp_path / "pixels", [replace(floor_camera(image), mask=mask)], create=True)
    assert fill_pixels(store, room, lambda done: None) == pytest.approx(0.5)
    mark_pure(store, room, np.zeros(2, int), lambda done: None)
    triangle = np.asarray(store.triangle).reshape(HEIGHT, WIDTH)
    assert (triangle[:, :8] == LEFT_OUT).all() and not np.asarray(store.pure).reshape(HEIGHT, WIDTH)[:, :8].any()
    assert (triangle[:2, 8:] == NO_TRIANGLE).all() and (triangle[4:, 8:] >= 0).all()
    ((_, radiance),) = outside_pixels(store)
    assert len(radiance) and np.allclose(radiance, 1.0)
