# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate recovers known materials despite noise and outliers."""

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.material.pixel_samples import window_means
from fipt_blender.core.material.projection import color_lines, fit_colors
from samples.material_pixels import LEVELS, materials_of, synthetic


@pytest.mark.parametrize("noise, outliers, within", [(0.0, 0.0, 0.01), (0.03, 0.05, 0.06)])
def test_known_materials_are_recovered(rng: np.random.Generator, noise: float, outliers: float, within: float) -> None:
    truths = [(1.0, 0.0), (float(LEVELS[3]), 0.0), (float(LEVELS[2]), 1.0), (float(LEVELS[5]), 1.0)]
    samples, color = synthetic(rng, truths, noise, outliers)
    roughness, metallic = materials = materials_of(samples)
    np.testing.assert_allclose(metallic, [metallic for _, metallic in truths], atol=1e-3)
    for estimated, (true, _) in zip(roughness, truths, strict=True):
        assert estimated == pytest.approx(true, abs=0.08)
    shadings, rows = ShadingStore(samples.diffuse, samples.specular), np.arange(len(samples.group))
    lines = color_lines(shadings, LEVELS, rows, np.stack(materials, axis=1)[samples.group])
    found = fit_colors(samples.radiance, *lines, samples.square_weight, samples.cell)[samples.cell]
    for index in range(len(truths)):
        rows = samples.group == index
        assert np.median(np.abs(found[rows] - color[rows])) < within


def test_an_empty_part_id_does_no_harm(rng: np.random.Generator) -> None:
    samples, _ = synthetic(rng, [(1.0, 0.0), (float(LEVELS[3]), 1.0)], 0.01, 0.0)
    roughness, metallic = materials_of(replace(samples, group=samples.group * 2))  # part 1 has no pixel
    assert len(roughness) == 3 and np.isfinite(roughness).all()
    assert metallic[2] == pytest.approx(1.0, abs=1e-3)
    none = materials_of(replace(samples, group=np.full_like(samples.group, -1)))
    assert all(len(values) == 0 for values in none)


def test_roughness_between_levels_is_found(rng: np.random.Generator) -> None:
    """Shadings halfway between two levels give the roughness at which the levels have equal shares."""
    samples, color = synthetic(rng, [(1.0, 0.0)], 0.0, 0.0)
    middle = 0.5 * (samples.specular[:, 3] + samples.specular[:, 4])
    radiance = (color * samples.diffuse + 0.04 * middle[:, 0] + middle[:, 1]).astype(np.float32)
    roughness, metallic = materials_of(replace(samples, radiance=radiance))
    assert roughness[0] == pytest.approx((0.5 * LEVELS[3] ** -2 + 0.5 * LEVELS[4] ** -2) ** -0.5, abs=1e-6)
    assert metallic[0] < 1e-3


def test_one_odd_view_does_not_make_a_part_glossy(rng: np.random.Generator) -> None:
    """Highlights in one view of many are an error of its shadings: views are the independent samples."""
    samples, color = synthetic(rng, [(1.0, 0.0)], 0.01, 0.0)
    odd = (samples.view == 0)[:, None]
    glossy = color * samples.diffuse + 0.04 * samples.specular[:, 3, 0] + samples.specular[:, 3, 1]
    mixed = np.where(odd, samples.radiance + 0.1 * (glossy - samples.radiance), samples.radiance)
    roughness, _ = materials_of(replace(samples, radiance=mixed.astype(np.float32)))
    assert roughness[0] > 0.9
    roughness, _ = materials_of(replace(samples, radiance=glossy.astype(np.float32)))
    assert roughness[0] == pytest.approx(LEVELS[3], abs=0.03)


def test_window_means_stay_within_part_and_view(rng: np.random.Generator) -> None:
    """Against a plain loop over two images of different sizes."""
    sizes = [(5, 7), (4, 3)]
    view = np.repeat([0, 1], [35, 12])
    widths = np.array([7, 3])
    count = len(view)
    part, pure = rng.integers(0, 2, count), rng.random(count) < 0.7
    values = rng.normal(size=(count, 2, 3)).astype(np.float32)
    rows = np.flatnonzero(pure)
    (means,) = window_means([values], rows, pure, part, np.array([0, 35, 47]), widths)
    for row, mean in zip(rows, means, strict=True):
        first = 35 * view[row]
        height, width = sizes[view[row]]
        y, x = divmod(row - first, width)
        near = [
            first + j * width + i
            for j in range(max(y - 1, 0), min(y + 2, height))
            for i in range(max(x - 1, 0), min(x + 2, width))
        ]
        near = [other for other in near if pure[other] and part[other] == part[row]]
        np.testing.assert_allclose(mean, values[near].mean(axis=0), rtol=1e-5, atol=1e-6)
