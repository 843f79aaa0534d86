# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Standard errors of the estimate against errors that are known, from made-up pixels."""

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.material import confidence
from fipt_blender.core.material.confidence import UNKNOWN, Evidence, evidence, standard_errors

LEVELS = np.linspace(0.02, 1.0, 6).astype(np.float32)
VIEWS, EACH = 6, 4


def made_up(cells: int, light: np.ndarray, noise: float, rng: np.random.Generator, gloss: float = 0.3):
    """Dielectric cells of unknown colour, lit by `light` (cells,), in VIEWS views of EACH pixels.

    Relative errors of shadings are alike within a view, and darkness adds some. The estimate is the
    least-squares colour, as training's is.
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
    seen = evidence(np.ones((count, 3)), true[cell], roughness, metallic, diffuse, specular, LEVELS)
    rendered = 1.0 - seen.residual
    errors = rng.standard_normal((cells, VIEWS, 3))[cell, view] + 0.1 * rng.standard_normal((count, 3))
    radiance = rendered + noise * (rendered + confidence.DARK) * errors
    weight = 1.0 / (rendered + confidence.DARK) ** 2
    slope = seen.by_color
    change = np.stack(
        [
            np.bincount(cell, (weight * slope * (radiance - rendered))[:, c])
            / np.bincount(cell, (weight * slope**2)[:, c])
            for c in range(3)
        ],
        axis=1,
    )
    color = true + change
    found = evidence(radiance, color[cell], roughness, metallic, diffuse, specular, LEVELS)
    return found, color, true, roughness, metallic, cell, view


def test_derivatives_are_those_of_the_rendering():
    rng = np.random.default_rng(0)
    radiance, color, diffuse = rng.uniform(0.1, 0.9, (3, 50, 3))
    roughness, metallic = rng.uniform(0.05, 0.95, (2, 50))
    specular = rng.uniform(0.0, 2.0, (50, 6, 2, 3))
    at = lambda a, s, m: evidence(radiance, a, s, m, diffuse, specular, LEVELS)  # noqa: E731
    here, step = at(color, roughness, metallic), 1e-4
    for moved, slope in (
        (at(color + step, roughness, metallic), here.by_color),
        (at(color, roughness + step, metallic), here.by_roughness),
        (at(color, roughness, metallic + step), here.by_metallic),
    ):
        found = (here.residual - moved.residual) / step
        assert np.quantile(np.abs(found - slope), 0.95) < 0.01  # a few steps cross a level


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_expected_errors_of_colour_are_the_errors_made(monkeypatch, noise):
    """Noise of each view alone: a sum in quadrature over cells, dark and light ones apart."""
    monkeypatch.setattr(confidence, "COMMON", 0.0)
    monkeypatch.setattr(confidence, "FLOOR", 0.0)
    light = np.repeat([0.02, 0.1, 1.0], 300)
    found, color, true, roughness, metallic, cell, view = made_up(
        900, light, noise, np.random.default_rng(1), gloss=0.0
    )
    found = replace(found, by_metallic=np.zeros_like(found.by_metallic))  # known to be no metal
    expected, _, _ = standard_errors(found, roughness, metallic, cell, np.zeros_like(cell), view)
    made = np.sqrt(((color - true) ** 2).mean(axis=1))
    for level in np.unique(light):
        mine = light == level
        ratio = np.sqrt((expected[mine] ** 2).mean() / (made[mine] ** 2).mean())
        assert 0.7 < ratio < 1.5, level
    means = [made[light == level].mean() for level in np.unique(light)]
    assert means[0] > 2 * means[1] > 3 * means[2]  # there is something to tell apart
    order = np.argsort(confidence.confidence(expected))
    binned = [np.sqrt((made[part] ** 2).mean()) for part in np.array_split(order, 3)]
    assert binned[0] > binned[1] > binned[2]


def test_without_gloss_roughness_and_metallic_stay_unknown():
    light = np.full(100, 0.5)
    for gloss, low, high in ((0.0, 0.8, 1.01), (1.0, 0.0, 0.5)):
        found, *_, roughness, metallic, cell, view = made_up(
            100, light, 0.002, np.random.default_rng(2), gloss
        )
        _, error, _ = standard_errors(found, roughness, metallic, cell, np.zeros_like(cell), view)
        assert low * UNKNOWN <= error[0] <= high * UNKNOWN


def test_errors_say_no_more_than_what_is_known_beforehand():
    found, *_, roughness, metallic, cell, view = made_up(20, np.full(20, 0.5), 0.01, np.random.default_rng(3))
    dark = Evidence(**{**vars(found), "by_color": np.zeros_like(found.by_color)})
    by_cell, *_ = standard_errors(dark, roughness, metallic, cell, np.zeros_like(cell), view)
    assert by_cell == pytest.approx(UNKNOWN, rel=1e-3)
    once = np.zeros_like(view)
    _, error, other = standard_errors(found, roughness, metallic, cell, once * 0, once)
    assert error[0] == UNKNOWN and other[0] == UNKNOWN  # one view tells no spread
    off = replace(found, residual=found.residual + 0.2)
    worse, *_ = standard_errors(off, roughness, metallic, cell, np.zeros_like(cell), view)
    better, *_ = standard_errors(found, roughness, metallic, cell, np.zeros_like(cell), view)
    assert worse.mean() > 2 * better.mean()


def test_confidence_is_the_share_of_ignorance_that_is_gone():
    assert confidence.confidence(np.array([0.0, UNKNOWN / 2, UNKNOWN, 1.0])).tolist() == [1.0, 0.5, 0.0, 0.0]
