# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's losses and emission mask against values by hand, and their gradients."""

import numpy as np
import pytest
import torch

from benchmarks import paper_losses as losses
from benchmarks.paper_losses import Prediction
from benchmarks.paper_mask import EmissionNetwork, emission_mask, positional_encoding
from fipt_blender.core.material.training import tone_map
from fipt_blender.core.optics.factorised import level_roughness


def test_the_emission_mask() -> None:
    emission = EmissionNetwork(torch.Generator().manual_seed(5), torch.device("cpu"))
    assert len(emission.layers) == 7 and emission.layers[3].in_features == 128 + 63  # the skip
    assert emission(torch.rand((300, 3))).shape == (300,)
    raw = torch.tensor([-1.0, 0.0, 1.0])
    assert emission_mask(raw).tolist() == pytest.approx([0.0, 0.0, 1 - np.exp(-1)])


def test_positional_encoding() -> None:
    x = torch.tensor([[0.25, -0.5, 1.0]], dtype=torch.float64)
    code = positional_encoding(x, 2)[0].tolist()
    angles = [np.pi * v * f for v in (0.25, -0.5, 1.0) for f in (1, 2)]
    assert code == pytest.approx([0.25, -0.5, 1.0, *np.sin(angles), *np.cos(angles)], abs=1e-12)


def prediction(seed: int, count: int = 6) -> tuple[torch.Tensor, ...]:
    """Base colour, roughness and metallic where the losses are differentiable, in double precision."""
    values = torch.rand((count, 5), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    values = 0.1 + 0.8 * values
    return tuple(v.clone().requires_grad_() for v in (values[:, :3], values[:, 3], values[:, 4]))


LEVELS = torch.tensor([0.02, 0.3, 1.0], dtype=torch.float64)
UNIFORM = torch.rand((6, 3, 2, 3), generator=torch.Generator().manual_seed(9), dtype=torch.float64)
LIGHT = UNIFORM[:, 0, 0] + 0.3


def test_specular_shading_at_and_between_levels() -> None:
    for index, level in enumerate(LEVELS):
        s0, s1 = losses.interpolate_specular(UNIFORM, level.repeat(6), LEVELS)
        assert torch.allclose(s0, UNIFORM[:, index, 0]) and torch.allclose(s1, UNIFORM[:, index, 1])
    quarter = level_roughness(0.25, *LEVELS[1:3])
    s0, _ = losses.interpolate_specular(UNIFORM, quarter.repeat(6), LEVELS)
    assert torch.allclose(s0, 0.75 * UNIFORM[:, 1, 0] + 0.25 * UNIFORM[:, 2, 0])
    s0, _ = losses.interpolate_specular(UNIFORM, torch.full((6,), 0.001, dtype=torch.float64), LEVELS)
    assert torch.allclose(s0, UNIFORM[:, 0, 0])
    roughness = prediction(1)[1]
    assert torch.autograd.gradcheck(lambda r: losses.interpolate_specular(UNIFORM, r, LEVELS), (roughness,))


def test_tone_mapping_and_rendering_loss() -> None:
    x = torch.tensor([0.0, 0.001, 1.0, 50.0, -1.0], dtype=torch.float64)
    logs = np.log1p([0.0, 0.001, 1.0, 50.0, 0.0])
    curve = np.where(logs <= 0.0031308, 12.92 * logs, 1.055 * logs ** (1 / 2.4) - 0.055)
    assert tone_map(x).tolist() == pytest.approx(curve.tolist())
    photographed = torch.full((6, 3), 2.0, dtype=torch.float64)
    ones = torch.ones(6, dtype=torch.float64)
    squared = (tone_map(LIGHT) - tone_map(photographed)).square().sum(dim=1)
    # With alpha = 1 emission explains the photograph; with 0 only the rendering counts.
    assert float(losses.rendering_loss(LIGHT, ones, photographed)) == 0.0
    assert float(losses.rendering_loss(LIGHT, ones * 0, photographed)) == pytest.approx(float(squared.mean()))
    rendered = LIGHT.clone().requires_grad_()
    alpha = torch.linspace(0.0, 0.9, 6, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda r, a: losses.rendering_loss(r, a, photographed), (rendered, alpha))


def test_emission_and_diffuse_terms() -> None:
    assert float(losses.emission_loss(torch.tensor([1.0, -2.0, 0.0, 0.0]))) == pytest.approx(0.75)
    values = prediction(3)
    expected = ((1 - values[1]) + values[2]).mean()
    assert float(losses.diffuse_loss(Prediction(*values))) == pytest.approx(float(expected.detach()))
    assert torch.autograd.gradcheck(lambda *v: losses.diffuse_loss(Prediction(*v)), values)


def test_semantic_term_is_its_equation(rng: np.random.Generator) -> None:
    """Eq. 20: sigma' is the mean over x' of the same class, weighted by distance in colour and position."""
    color, roughness, metallic = (v.detach().numpy() for v in prediction(5))
    positions = rng.random((6, 3)) * 0.2
    part = np.array([0, 0, 1, 1, -1, 2])
    partners = np.array([0, 1, 2, 3, 4])
    total = 0.0
    for i in range(6):
        weights, means = 0.0, np.zeros(2)
        for j in partners:
            if part[i] != part[j] or part[i] < 0:
                continue
            w = np.exp(-((color[i] - color[j]) ** 2).sum() / (2 * 0.3**2))
            w *= np.exp(-((positions[i] - positions[j]) ** 2).sum() / (2 * 0.1**2))
            weights += w
            means += w * np.array([roughness[j], metallic[j]])
        if weights > 0:  # the last pixel has no partner, the fifth no class
            total += np.abs(np.array([roughness[i], metallic[i]]) - means / weights).sum()
    arguments = [torch.from_numpy(a) for a in (positions, part, partners)]
    loss = losses.semantic_loss(Prediction(*prediction(5)), *arguments, 0.3, 0.1)
    assert float(loss) == pytest.approx(total / 6, rel=1e-9)


def test_semantic_term_has_the_gradient_of_fixed_means() -> None:
    """sigma' and m' are constant targets: x' gets no gradient."""
    values = prediction(6)
    positions = torch.zeros((6, 3), dtype=torch.float64)
    part, partners = torch.zeros(6, dtype=torch.int64), torch.arange(6)
    losses.semantic_loss(Prediction(*values), positions, part, partners, 10.0, 10.0).backward()
    for value in values[1:]:
        sign = torch.sign(value.detach() - value.detach().mean())
        assert torch.allclose(value.grad, sign / 6)
    assert values[0].grad is None or (values[0].grad == 0).all()
