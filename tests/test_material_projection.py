# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form start finds known materials again, through noise and stray pixels."""

import numpy as np
import pytest

from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.material.gloss import part_materials
from fipt_blender.core.material.projection import (
    Guess,
    constant_parts,
    project,
    window_means,
)

LEVELS = roughness_levels(8, 0.02, 1.5)
CELLS, VIEWS = 300, 8


def synthetic(rng: np.random.Generator, truths: list[tuple[float, float]], noise: float, stray: float):
    """Pixels of one part for each (roughness, metallic): radiance, shadings, cells, parts and base colours.

    Highlights differ between views and grow sharper with lower roughness, as they do in a room.
    """
    parts = len(truths)
    count = parts * CELLS * VIEWS
    part = np.repeat(np.arange(parts), CELLS * VIEWS)
    cell = np.repeat(np.arange(parts * CELLS), VIEWS)
    diffuse = np.repeat(rng.uniform(0.5, 2.0, (parts * CELLS, 1)), VIEWS, axis=0) * [1.0, 0.9, 0.8]
    angle = rng.exponential(0.35, count)[:, None]  # between the mirror direction and a lamp
    width = 0.03 + 0.9 * LEVELS**2
    s0 = 0.3 + 6.0 * np.exp(-((angle / width) ** 2)) * np.minimum(0.25 / width, 6.0)
    s1 = 0.03 * s0
    specular = np.stack([s0, s1], axis=2)[..., None] * [1.0, 0.95, 0.9]
    color = rng.uniform(0.1, 0.9, (parts * CELLS, 3))[cell]
    radiance = np.empty((count, 3))
    for index, (roughness, metallic) in enumerate(truths):
        rows = part == index
        level = np.abs(LEVELS - roughness).argmin()
        ks = 0.04 * (1 - metallic) + color[rows] * metallic
        radiance[rows] = color[rows] * (1 - metallic) * diffuse[rows] + ks * specular[rows, level, 0]
        radiance[rows] += specular[rows, level, 1]
    radiance *= 1.0 + noise * rng.normal(size=radiance.shape)
    wrong = rng.random(count) < stray
    radiance[wrong] *= rng.uniform(0.0, 5.0, (wrong.sum(), 1))
    arrays = (radiance, diffuse, specular)
    return [np.asarray(a, np.float32) for a in arrays], cell, part, color


def guess_from(arrays: list[np.ndarray], cell: np.ndarray, part: np.ndarray) -> Guess:
    """Both steps, with pixels that take turns among the views."""
    view = np.arange(len(part)) % VIEWS
    return project(*arrays, LEVELS, cell, part, *part_materials(*arrays, LEVELS, cell, cell, part, view))


@pytest.mark.parametrize("noise, stray, within", [(0.0, 0.0, 0.01), (0.03, 0.05, 0.06)])
def test_known_materials_are_recovered(
    rng: np.random.Generator, noise: float, stray: float, within: float
) -> None:
    truths = [(1.0, 0.0), (float(LEVELS[3]), 0.0), (float(LEVELS[2]), 1.0), (float(LEVELS[5]), 1.0)]
    arrays, cell, part, color = synthetic(rng, truths, noise, stray)
    guess = guess_from(arrays, cell, part)
    assert guess.part_metallic.tolist() == [metallic for _, metallic in truths]
    for found, (roughness, _) in zip(guess.part_roughness, truths, strict=True):
        assert found == pytest.approx(roughness, abs=0.08)
    for index in range(len(truths)):
        rows = part == index
        assert np.median(np.abs(guess.base_color[rows] - color[rows])) < within
    assert (guess.roughness == guess.part_roughness[part]).all()
    assert guess.emitting.mean() <= 0.2 * stray  # strays five times too bright pass for light


def test_pixels_without_part_are_diffuse_and_lamps_are_marked(rng: np.random.Generator) -> None:
    (radiance, diffuse, specular), cell, part, color = synthetic(rng, [(1.0, 0.0)], 0.01, 0.0)
    part[:] = -1
    lamp = cell < 5
    radiance[lamp] = 40.0
    guess = guess_from([radiance, diffuse, specular], cell, part)
    assert (guess.roughness == 1.0).all() and (guess.metallic == 0.0).all()
    assert guess.emitting[lamp].all() and not guess.emitting[~lamp].any()
    assert np.median(np.abs(guess.base_color[~lamp] - color[~lamp])) < 0.02
    assert len(guess.part_roughness) == 0


def test_cells_of_different_parts_stay_apart(rng: np.random.Generator) -> None:
    """The same voxel holds a red and a blue part."""
    count = 400
    part = np.arange(count) % 2
    color = np.where(part[:, None] == 0, [0.8, 0.1, 0.1], [0.1, 0.1, 0.8])
    light = rng.uniform(0.5, 2.0, (count, 1)) * np.ones(3)
    specular = np.full((count, len(LEVELS), 2, 3), 1e-3, np.float32)
    guess = guess_from([(color * light).astype(np.float32), light, specular], np.zeros(count, int), part)
    np.testing.assert_allclose(guess.base_color, color, atol=0.01)


def test_an_empty_part_id_does_no_harm(rng: np.random.Generator) -> None:
    arrays, cell, part, _ = synthetic(rng, [(1.0, 0.0), (float(LEVELS[3]), 1.0)], 0.01, 0.0)
    part = part * 2  # part 1 has no pixel
    guess = guess_from(arrays, cell, part)
    assert len(guess.part_roughness) == 3 and np.isfinite(guess.part_roughness).all()
    assert guess.part_metallic[2] == 1.0


def test_what_shines_alike_under_uneven_light_is_a_lamp(rng: np.random.Generator) -> None:
    """A dim panel of constant radiance against a wall, a texture and a surface under even light."""
    count = 400
    light = rng.uniform(1.0, 3.0, count)
    noise = 1.0 + 0.02 * rng.normal(size=count)
    panel, wall = np.full(count, 0.9) * noise, 0.6 * light * noise
    texture = rng.uniform(0.2, 0.8, count) * light
    even = np.full(count, 2.0)
    radiance = np.concatenate([panel, wall, texture, 0.5 * even])
    irradiance = np.concatenate([light, light, light, even])
    part = np.repeat([0, 1, 2, 3], count)
    order = rng.permutation(len(part))
    found = constant_parts(radiance[order], irradiance[order], part[order], 5)
    assert found.tolist() == [True, False, False, False, False]
    # A few pixels prove nothing, and pixels without a part are nobody's.
    assert not constant_parts(panel[:20], light[:20], np.zeros(20, int), 1).any()
    assert not constant_parts(panel, light, np.full(count, -1), 1).any()


def test_roughness_between_levels_is_found(rng: np.random.Generator) -> None:
    """Shadings halfway between two levels give the roughness halfway between them."""
    (_, diffuse, specular), cell, part, color = synthetic(rng, [(1.0, 0.0)], 0.0, 0.0)
    middle = 0.5 * (specular[:, 3] + specular[:, 4])
    radiance = (color * diffuse + 0.04 * middle[:, 0] + middle[:, 1]).astype(np.float32)
    view = np.arange(len(part)) % VIEWS
    roughness, metallic = part_materials(radiance, diffuse, specular, LEVELS, cell, cell, part, view)
    assert roughness[0] == pytest.approx(0.5 * (LEVELS[3] + LEVELS[4]), abs=1e-6)
    assert metallic[0] == 0.0


def test_one_odd_view_does_not_make_a_part_glossy(rng: np.random.Generator) -> None:
    """Highlights in a single view of many are an error of that view's shadings: views are the samples."""
    (radiance, diffuse, specular), cell, part, color = synthetic(rng, [(1.0, 0.0)], 0.01, 0.0)
    view = np.arange(len(part)) % VIEWS
    odd = (view == 0)[:, None]
    glossy = color * diffuse + 0.04 * specular[:, 3, 0] + specular[:, 3, 1]
    mixed = np.where(odd, radiance + 0.1 * (glossy - radiance), radiance).astype(np.float32)
    roughness, _ = part_materials(mixed, diffuse, specular, LEVELS, cell, cell, part, view)
    assert roughness[0] > 0.9
    roughness, _ = part_materials(
        glossy.astype(np.float32), diffuse, specular, LEVELS, cell, cell, part, view
    )
    assert roughness[0] == pytest.approx(LEVELS[3], abs=0.03)


def test_window_means_stay_within_part_and_view(rng: np.random.Generator) -> None:
    """Against a plain loop over two images of unlike sizes."""
    sizes = [(5, 7), (4, 3)]
    view = np.repeat([0, 1], [35, 12])
    widths = np.array([7, 3])
    count = len(view)
    part, usable = rng.integers(0, 2, count), rng.random(count) < 0.7
    values = rng.normal(size=(count, 2, 3)).astype(np.float32)
    rows = np.flatnonzero(usable)
    (found,) = window_means([values], rows, usable, part, np.array([0, 35, 47]), widths)
    for row, mean in zip(rows, found, strict=True):
        first = 35 * view[row]
        height, width = sizes[view[row]]
        y, x = divmod(row - first, width)
        near = [
            first + j * width + i
            for j in range(max(y - 1, 0), min(y + 2, height))
            for i in range(max(x - 1, 0), min(x + 2, width))
        ]
        near = [other for other in near if usable[other] and part[other] == part[row]]
        np.testing.assert_allclose(mean, values[near].mean(axis=0), rtol=1e-5, atol=1e-6)
