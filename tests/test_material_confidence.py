# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Expected standard errors compared with the actual errors of synthetic pixels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.material import confidence
from fipt_blender.core.material.cell_errors import groups_of_cells
from fipt_blender.core.material.confidence import (
    UNIFORM_DEVIATION,
    LinearisedPixels,
    linearise,
    standard_errors,
)
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.pixel_samples import PixelSamples
from fipt_blender.core.material.projection import RADIANCE_FLOOR
from fipt_blender.core.material.seen import Box, SeenCells

LEVELS = np.linspace(0.02, 1.0, 6).astype(np.float32)
VIEWS, EACH = 6, 4


def synthetic(
    cells: int, light: np.ndarray, noise: float, rng: np.random.Generator, gloss: float = 0.3
) -> tuple[LinearisedPixels, np.ndarray, np.ndarray]:
    """Dielectric cells lit by `light` (cells,) in VIEWS views of EACH pixels; estimated and true colours.

    All cells are one group. Relative errors of the shadings are correlated within a view and larger where it
    is dark. The estimate is the least-squares colour, as in training.
    """
    true = rng.uniform(0.2, 0.8, (cells, 3))
    cell = np.repeat(np.arange(cells), VIEWS * EACH)
    view = np.tile(np.repeat(np.arange(VIEWS), EACH), cells)
    count = len(cell)
    diffuse = np.repeat(light[cell][:, None], 3, axis=1)
    lobe = gloss * rng.uniform(0.5, 1.5, count) * light[cell]
    by_level = lobe[:, None] / (1.0 + LEVELS)
    specular = np.broadcast_to(by_level[:, :, None, None], (count, len(LEVELS), 2, 3))
    roughness, metallic = np.full(count, 0.5, np.float32), np.zeros(count, np.float32)
    samples = PixelSamples(
        np.arange(count),
        np.ones((count, 3)),
        diffuse,
        specular,
        LEVELS,
        cell,
        np.zeros_like(cell),
        view,
        np.ones(count, np.float32),
    )
    at_truth = linearise(samples, true[cell], roughness, metallic)
    rendered = 1.0 - at_truth.residual
    errors = rng.standard_normal((cells, VIEWS, 3))[cell, view] + 0.1 * rng.standard_normal((count, 3))
    radiance = rendered + noise * (rendered + RADIANCE_FLOOR) * errors
    weight = 1.0 / (rendered + RADIANCE_FLOOR) ** 2
    slope = at_truth.by_color
    change = np.stack(
        [
            np.bincount(cell, (weight * slope * (radiance - rendered))[:, c])
            / np.bincount(cell, (weight * slope**2)[:, c])
            for c in range(3)
        ],
        axis=1,
    )
    color = true + change
    return linearise(replace(samples, radiance=radiance), color[cell], roughness, metallic), color, true


def test_derivatives_are_those_of_the_rendering():
    rng = np.random.default_rng(0)
    radiance, color, diffuse = rng.uniform(0.1, 0.9, (3, 50, 3))
    roughness, metallic = rng.uniform(0.05, 0.95, (2, 50))
    specular = rng.uniform(0.0, 2.0, (50, 6, 2, 3))
    index = np.zeros(50, int)
    samples = PixelSamples(
        np.arange(50), radiance, diffuse, specular, LEVELS, index, index, index, np.ones(50, np.float32)
    )
    at = lambda a, s, m: linearise(samples, a, s, m)  # noqa: E731
    here, step = at(color, roughness, metallic), 1e-4
    for moved, slope in (
        (at(color + step, roughness, metallic), here.by_color),
        (at(color, roughness + step, metallic), here.by_roughness),
        (at(color, roughness, metallic + step), here.by_metallic),
    ):
        difference = (here.residual - moved.residual) / step
        assert np.quantile(np.abs(difference - slope), 0.95) < 0.01  # a few steps cross a level


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_expected_errors_of_colour_are_the_actual_errors(monkeypatch, noise):
    """Only independent noise of each view; root mean squares over dark and over bright cells."""
    monkeypatch.setattr(confidence, "COMMON", 0.0)
    monkeypatch.setattr(confidence, "FLOOR", 0.0)
    light = np.repeat([0.02, 0.1, 1.0], 300)
    pixels, color, true = synthetic(900, light, noise, np.random.default_rng(1), gloss=0.0)
    expected = standard_errors(pixels, np.zeros((900, 2)))
    actual = np.sqrt(((color - true) ** 2).mean(axis=1))
    for level in np.unique(light):
        cells = light == level
        ratio = np.sqrt((expected[cells] ** 2).mean() / (actual[cells] ** 2).mean())
        assert 0.7 < ratio < 1.5, level
    means = [actual[light == level].mean() for level in np.unique(light)]
    assert means[0] > 2 * means[1] > 3 * means[2]  # the levels differ
    order = np.argsort(confidence.confidence(expected))
    binned = [np.sqrt((actual[part] ** 2).mean()) for part in np.array_split(order, 3)]
    assert binned[0] > binned[1] > binned[2]


def test_colour_is_uncertain_where_it_compensates_an_uncertain_material():
    """A metallic that is wrong by 0.1 changes the diffuse reflectance of a surface without gloss by 10 %."""
    pixels, color, _ = synthetic(200, np.full(200, 0.5), 0.002, np.random.default_rng(2), gloss=0.0)
    known, unknown = (standard_errors(pixels, np.tile([0.0, error], (200, 1))) for error in (0.0, 0.1))
    added = np.sqrt(unknown**2 - known**2)
    assert added == pytest.approx(0.1 * np.sqrt((color**2).mean(axis=1)), rel=0.1)
    # Without gloss, roughness changes nothing.
    assert standard_errors(pixels, np.tile([0.2, 0.0], (200, 1))) == pytest.approx(known)


def test_errors_never_exceed_those_of_the_uniform_prior():
    pixels, *_ = synthetic(20, np.full(20, 0.5), 0.01, np.random.default_rng(3))
    certain = np.zeros((20, 2))
    color_error = standard_errors(replace(pixels, by_color=np.zeros_like(pixels.by_color)), certain)
    assert color_error == pytest.approx(UNIFORM_DEVIATION, rel=1e-3)
    assert standard_errors(pixels, np.full((20, 2), 10.0)).max() <= UNIFORM_DEVIATION
    worse = standard_errors(replace(pixels, residual=pixels.residual + 0.2), certain)
    better = standard_errors(pixels, certain)
    assert worse.mean() > 2 * better.mean()


def test_confidence_is_one_minus_the_error_relative_to_the_priors():
    errors = np.array([0.0, UNIFORM_DEVIATION / 2, UNIFORM_DEVIATION, 1.0])
    assert confidence.confidence(errors).tolist() == [1.0, 0.5, 0.0, 0.0]


def test_many_units_stay_apart() -> None:
    """Also from unit 8191 on, where 32 bits do not hold the pair of unit and block."""
    part = np.array([-1, 0, 8190, 8191, 8192, 16384, 16384 + 8191, 100_000, 116_384], np.int32)
    for single in (True, False):
        units = Units(part, np.full(part.max() + 1, single))
        fields = SimpleNamespace(box=Box(np.zeros(3), 1.0))
        cells = SeenCells(np.arange(len(part)), np.full((len(part), 3), 0.5, np.float32), part)
        assert len(np.unique(groups_of_cells(units, fields, cells))) == len(part)


def test_base_color_is_less_certain_on_a_scan() -> None:
    errors = np.array([[0.02, 0.1, 0.2], [0.2, 0.1, 0.2], [UNIFORM_DEVIATION] * 3], np.float32)
    scan = confidence.errors_on_scan(errors)
    assert scan.dtype == np.float32 and np.array_equal(scan[:, 1:], errors[:, 1:])
    assert scan[0, 0] > 0.05 and scan[0, 0] < 0.1  # what was certain loses most
    assert errors[1, 0] < scan[1, 0] < 1.1 * errors[1, 0]
    assert scan[2, 0] == errors[2, 0]
