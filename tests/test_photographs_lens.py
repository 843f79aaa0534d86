"""Lenses by EXIF: focal lengths, vignetting and distortion from lensfun's database."""

from __future__ import annotations

from dataclasses import replace

import lensfunpy
import numpy as np
import pytest

from fipt_blender.prepare import lens
from fipt_blender.prepare.preparation import Photograph

KNOWN = Photograph(
    "a.cr2",
    "raw",
    5760,
    3840,
    aperture=4.0,
    focal_length=24.0,
    make="Canon",
    model="Canon EOS 5D Mark III",
    lens="EF24-105mm f/4L IS USM",
)


def known_modifier(width: int, height: int) -> lensfunpy.Modifier:
    database = lensfunpy.Database()
    camera = database.find_cameras(KNOWN.make, KNOWN.model)[0]
    return lensfunpy.Modifier(database.find_lenses(camera, None, KNOWN.lens)[0], camera.crop_factor, width, height)


def lensfun_gain(width: int, height: int) -> np.ndarray:
    """The factors that lensfun itself applies to an image of the known lens."""
    modifier = known_modifier(width, height)
    flags = lensfunpy.ModifyFlags.VIGNETTING
    modifier.initialize(24.0, 4.0, lens.ROOM_DISTANCE, scale=1.0, pixel_format=np.float32, flags=flags)
    image = np.ones((height, width, 3), np.float32)
    assert modifier.apply_color_modification(image)
    return image[..., 1]


def test_vignetting_of_a_known_lens_is_that_of_lensfun() -> None:
    falloff = lens.vignetting(KNOWN)
    gain = 1.0 / lens.light_share(falloff, 1200, 800)
    assert gain.shape == (800, 1200) and gain.dtype == np.float32
    assert np.abs(gain / lensfun_gain(1200, 800) - 1.0).max() < 0.02  # only the corners' last pixels
    assert gain[400, 600] == pytest.approx(1.0, abs=1e-4) and gain[0, 0] > 2.0
    assert np.allclose(gain, gain[::-1, ::-1]), "it is symmetric about the center"
    assert np.allclose(1.0 / lens.light_share(falloff, 800, 1200), gain.T, rtol=1e-5)


@pytest.mark.parametrize(
    "other",
    [{"lens": "", "focal_length": 24.0}, {"model": "Unknown 1"}, {"focal_length": 300.0}, {"focal_length": None}],
)
def test_an_unknown_lens_has_no_correction(other: dict[str, object]) -> None:
    assert lens.vignetting(replace(KNOWN, **other)) is None


def test_the_start_of_a_solve_follows_the_distortion_of_lensfun() -> None:
    width, height = 576, 384
    focal, (first, second) = lens.start(KNOWN, width, height)
    nominal = lens.focal_pixels(KNOWN, width, height)
    assert focal is not None and nominal is not None
    assert nominal == pytest.approx(24.0 / 36.0 * width, rel=1e-3)
    modifier = known_modifier(width, height)
    modifier.initialize(24.0, 4.0, scale=1.0, flags=lensfunpy.ModifyFlags.DISTORTION)
    bent = modifier.apply_geometry_distortion() - [0.5 * (width - 1), 0.5 * (height - 1)]
    y, x = np.mgrid[0:height, 0:width]
    straight = np.stack([x - 0.5 * (width - 1), y - 0.5 * (height - 1)], axis=-1) / nominal
    squared = (straight**2).sum(axis=-1, keepdims=True)
    model = focal * straight * (1.0 + first * squared + second * squared**2)
    assert first < -0.05, "barrel distortion at the wide end"
    assert np.abs(model - bent).max() < 1.0 < np.abs(nominal * straight - bent).max()


def test_focal_length_in_pixels() -> None:
    phone = Photograph("a.jpg", "ldr", 4000, 3000, focal_length=4.2, focal_35mm=26.0)
    expected = 26.0 / np.hypot(36.0, 24.0) * 5000.0
    assert lens.focal_pixels(phone, 4000, 3000) == pytest.approx(expected)
    assert lens.focal_pixels(phone, 1500, 2000) == pytest.approx(expected / 2.0), "turned and scaled"
    assert lens.start(replace(phone, focal_35mm=None), 4000, 3000)[0] is None, "its sensor's size is unknown"
