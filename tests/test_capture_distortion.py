# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A pattern photographed through a distorted lens is resampled to what a pinhole camera sees."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.capture.distortion import (
    Undistortion,
    is_distorted,
    lens_camera,
    lens_pinhole,
    undistorted_pinhole,
)
from fipt_blender.core.capture.rig import Lens
from samples.refusals import error_of

WIDTH, HEIGHT = 160, 120
LENSES = [
    Lens("SIMPLE_RADIAL", (150.0, 80.0, 60.0, 0.15)),
    Lens("RADIAL", (150.0, 84.0, 57.0, -0.1, 0.03)),
    Lens("OPENCV", (150.0, 135.0, 77.0, 63.0, -0.2, 0.05, 0.004, -0.003)),
    Lens("FULL_OPENCV", (150.0, 150.0, 80.0, 60.0, -0.1, 0.02, 0.001, 0.0, 0.01, 0.0, 0.0, 0.0)),
    Lens("OPENCV_FISHEYE", (110.0, 105.0, 80.0, 60.0, 0.02, 0.0, 0.0, 0.0)),
    Lens("SIMPLE_FISHEYE", (110.0, 80.0, 60.0)),
    Lens("FOV", (150.0, 150.0, 80.0, 60.0, 0.4)),
    Lens("EUCM", (130.0, 130.0, 80.0, 60.0, 0.5, 1.1)),
]


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) in direction (x, y, 1): smooth, with values far above 1 and close to 0."""
    return np.stack([50.0 + 45.0 * np.sin(9.0 * x), np.exp(4.0 * y), 1e-3 * (2.0 + np.cos(8.0 * (x + y)))], -1)


def parts(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where(x + 0.3 * y > 0.05, 1000, 7).astype(np.int32)


def seen_through(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Directions x, y (HEIGHT, WIDTH) of the distorted image's pixel centres."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    positions = np.stack([columns.ravel(), rows.ravel()], axis=1)
    directions = np.asarray(lens_camera(lens, WIDTH, HEIGHT).cam_from_img(positions))
    return directions[:, 0].reshape(HEIGHT, WIDTH), directions[:, 1].reshape(HEIGHT, WIDTH)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_undistorted_pattern_is_the_pinholes(lens):
    assert is_distorted(lens, WIDTH, HEIGHT)
    x, y = seen_through(lens)
    resampling = Undistortion(lens, WIDTH, HEIGHT)
    pinhole = resampling.pinhole
    assert pinhole == undistorted_pinhole(lens, WIDTH, HEIGHT)
    image, ids = resampling.image(pattern(x, y).astype(np.float32)), resampling.ids(parts(x, y))
    assert image.shape == (pinhole.height, pinhole.width, 3) and image.dtype == np.float32
    u, v = np.meshgrid(
        (np.arange(pinhole.width) + 0.5 - pinhole.cx) / pinhole.fx,
        (np.arange(pinhole.height) + 0.5 - pinhole.cy) / pinhole.fy,
    )
    # bilinear error of these sines is below 0.2 % of their range; half a pixel's shift would be 3 %
    np.testing.assert_allclose(image / [95.0, 1.0, 3e-3], pattern(u, v) / [95.0, 1.0, 3e-3], atol=4e-3, rtol=4e-3)
    assert set(np.unique(ids)) == {7, 1000}  # nearest neighbour does not interpolate ids
    assert (ids != parts(u, v)).mean() < 0.01


def test_without_distortion_the_lens_is_a_pinhole():
    for lens in (
        Lens("PINHOLE", (150.0, 135.0, 70.0, 66.0)),
        Lens("OPENCV", (150.0, 135.0, 70.0, 66.0, 0.0, 0.0, 0.0, 0.0)),
    ):
        assert not is_distorted(lens, WIDTH, HEIGHT)
        pinhole = lens_pinhole(lens, WIDTH, HEIGHT)
        assert (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy) == (150.0, 135.0, 70.0, 66.0)


@pytest.mark.parametrize(
    "lens",
    [
        Lens("EQUIRECTANGULAR", ()),
        Lens("PINHOLE", (1.0, 2.0)),
        Lens("NO_SUCH_MODEL", (1.0,)),
        Lens("OPENCV", (150.0, 150.0, 80.0, 60.0, 40.0, -900.0, 0.0, 0.0)),
    ],
)
def test_lenses_that_cannot_be_undone(lens):
    assert error_of(undistorted_pinhole, lens, WIDTH, HEIGHT).code == "camera-model"
