# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that reflect: the line of radiance over shading, and when it is not to be trusted."""

import numpy as np
import pytest

from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.light.reflecting import LampPixels, separate

EMITTED = np.array([3.0, 2.0, 1.0])
COLOR = np.array([0.8, 0.6, 0.4])


def lamp(total: np.ndarray) -> Fixture:
    return Fixture(np.array([4, 5]), total, np.zeros(3), 1.0, np.zeros(3))


def lamp_pixels(
    color: np.ndarray, rng: np.random.Generator, noise: float = 0.02, count: int = 600
) -> LampPixels:
    """A lamp of `color` under uneven light; a twentieth of its pixels are far off."""
    diffuse = rng.uniform(0.2, 1.5, (count, 1)) * [1.0, 0.9, 0.8]
    specular = 0.3 * np.stack([diffuse, 0.1 * diffuse], axis=1)
    reflects = float(color.any())
    radiance = EMITTED + color * diffuse + reflects * (0.04 * specular[:, 0] + specular[:, 1])
    radiance += noise * rng.standard_normal((count, 3))
    radiance[::20] *= 1.5
    view = np.repeat(np.arange(6), count // 6)
    return LampPixels(rng.integers(4, 6, count), np.ones(count, bool), view, radiance, diffuse, specular)


@pytest.mark.parametrize("seed", range(3))
def test_emission_and_base_colour_come_apart(seed):
    pixels = lamp_pixels(COLOR, np.random.default_rng(seed))
    total = np.median(pixels.radiance, axis=0)
    (found,), colors = separate([lamp(total)], pixels)
    np.testing.assert_allclose(colors[0], COLOR, atol=0.02)
    np.testing.assert_allclose(found.radiance, EMITTED, rtol=0.01)
    assert not found.back_radiance.any()


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.3])
def test_black_lamps_stay_as_they_are(noise):
    for seed in range(20):
        before = lamp(EMITTED)
        (found,), colors = separate([before], lamp_pixels(np.zeros(3), np.random.default_rng(seed), noise))
        assert found is before and not colors.any()


def test_uneven_emission_that_shading_hardly_explains_is_no_reflection():
    rng = np.random.default_rng(0)
    pixels = lamp_pixels(np.zeros(3), rng)
    pixels.radiance[:] += 0.3 * pixels.diffuse + 0.5 * rng.standard_normal((600, 1))
    (found,), colors = separate([before := lamp(EMITTED)], pixels)
    assert found is before and not colors.any()


def test_few_pixels_or_views_tell_nothing():
    rng = np.random.default_rng(0)
    for pixels in (lamp_pixels(COLOR, rng, count=36), lamp_pixels(COLOR, rng)):
        if len(pixels.view) > 100:
            pixels.view[:] = pixels.view % 2
        assert not separate([lamp(EMITTED)], pixels)[1].any()
