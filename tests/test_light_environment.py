# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The environment map: what pixels saw comes back, the rest is filled, medians ignore outliers."""

import mitsuba as mi
import numpy as np

from fipt_blender.core.conventions import equirect_pixel_directions
from fipt_blender.core.light.environment import MOST_PIXELS, Environment, estimate_environment
from fipt_blender.core.optics.environment import EnvironmentLight


def estimated(directions: np.ndarray, radiance: np.ndarray, width: int, rng: np.random.Generator) -> Environment | None:
    """Of pixels that come in pieces, as views do."""
    pieces = [(directions[first::3], radiance[first::3]) for first in range(3)]
    return estimate_environment(lambda: pieces, width, rng)


def test_pixels_that_look_outside_give_the_map_back(rng: np.random.Generator) -> None:
    image = rng.uniform(0.1, 2.0, (16, 32, 3)).astype(np.float32)
    directions = np.repeat(equirect_pixel_directions(32, 16).reshape(-1, 3), 3, axis=0)
    radiance = np.repeat(image.reshape(-1, 3), 3, axis=0)
    radiance[1::3] *= 50.0  # a stray pixel in each cell: the median forgets it
    order = rng.permutation(len(directions))
    found = estimated(directions[order], radiance[order], 32, rng)
    assert found is not None and found.observed_share == 1.0
    np.testing.assert_array_equal(found.image, image)
    # and rays that leave the room look it up in the same place
    light = EnvironmentLight(found.image)
    rays = mi.Vector3f(directions[::3].T.astype(np.float32).copy())
    np.testing.assert_allclose(np.array(light.radiance(rays)).T, image.reshape(-1, 3))


def test_unseen_cells_take_the_nearest_ones(rng: np.random.Generator) -> None:
    """Only a window to the east is seen: everything has its radiance, across the seam of the map too."""
    directions = equirect_pixel_directions(64, 32).reshape(-1, 3)
    east = directions[:, 0] > 0.9
    found = estimated(directions[east], np.tile([[1.0, 2.0, 3.0]], (east.sum(), 1)), 64, rng)
    assert found is not None
    np.testing.assert_allclose(found.image, np.tile([1.0, 2.0, 3.0], (32, 64, 1)), rtol=1e-6)
    assert abs(found.observed_share - 0.05) < 0.01  # (1 - 0.9) / 2 of the sphere
    west = directions[:, 0] < -0.95
    radiance = np.where(east[:, None], 4.0, 1.0) * np.ones(3)
    both = estimated(directions[east | west], radiance[east | west], 64, rng)
    assert both is not None
    flat = both.image.reshape(-1, 3)
    assert (flat[directions[:, 0] > 0.8] == 4.0).mean() > 0.9
    assert (flat[directions[:, 0] < -0.85] == 1.0).mean() > 0.9


def test_of_many_pixels_some_are_enough(rng: np.random.Generator) -> None:
    """Beyond MOST_PIXELS a cell's median is that of a sample: unbiased, and stray pixels stay forgotten."""
    image = rng.uniform(0.1, 2.0, (8, 16, 3))
    times = 20 * MOST_PIXELS
    directions = np.repeat(equirect_pixel_directions(16, 8).reshape(-1, 3), times, axis=0)
    radiance = np.repeat(image.reshape(-1, 3), times, axis=0)
    radiance *= rng.uniform(0.9, 1.1, (len(radiance), 1))
    radiance[::5] *= 50.0
    found = estimated(directions, radiance.astype(np.float32), 16, rng)
    assert found is not None
    ratio = found.image[..., 0] / image[..., 0]
    # A fifth lies above all others, so the median is at 5/8 of these: 0.9 + 0.2 * 5/8; its error by chance
    # is half a range over the square root of the sample.
    assert abs(ratio.mean() - 1.025) < 0.003
    assert 0.2 < ratio.std() / (0.125 / MOST_PIXELS**0.5) < 2.0


def test_no_pixel_outside_or_a_hole_in_the_mesh_is_no_environment(rng: np.random.Generator) -> None:
    assert estimate_environment(lambda: [], 64, rng) is None
    directions = equirect_pixel_directions(256, 128).reshape(-1, 3)
    hole = directions[:, 0] > 0.9995
    assert hole.any()
    assert estimated(directions[hole], np.full((hole.sum(), 3), 5.0), 256, rng) is None
