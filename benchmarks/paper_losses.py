# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""All terms of the paper's loss (Eq. 15 to 20), for the reference of the speed benchmark.

The product fits base colour alone: roughness, metallic and emission have a closed form there.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from fipt_blender.core.material.training import tone_map
from fipt_blender.core.optics import factorised


@dataclass(frozen=True)
class Prediction:
    """Output of MLP_brdf at N points: (N, 3) base colour, (N,) roughness and (N,) metallic."""

    base_color: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor


def interpolate_specular(
    specular: torch.Tensor, roughness: torch.Tensor, levels: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """L_s0 and L_s1 at a roughness, interpolated between baked levels (after paper Eq. 8).

    Args:
        specular: (N, K, 2, 3) baked at `levels`.
        roughness: (N,).
        levels: (K,) ascending.

    Returns:
        Two (N, 3) tensors, differentiable in `roughness`.
    """
    upper = torch.searchsorted(levels, roughness.detach()).clamp(1, len(levels) - 1)
    low, high = levels[upper - 1], levels[upper]
    t = factorised.level_share(roughness, low, high).clamp(0.0, 1.0)[:, None, None]
    rows = torch.arange(len(roughness), device=roughness.device)
    value = torch.lerp(specular[rows, upper - 1], specular[rows, upper], t)
    return value[:, 0], value[:, 1]


def reflectances(prediction: Prediction) -> tuple[torch.Tensor, torch.Tensor]:
    """kd and ks, each (N, 3)."""
    color, metallic = prediction.base_color, prediction.metallic[:, None]
    return factorised.diffuse_reflectance(color, metallic), factorised.specular_reflectance(color, metallic)


def rendering_loss(rendered: torch.Tensor, alpha: torch.Tensor, photographed: torch.Tensor) -> torch.Tensor:
    """Tone-mapped L2 with the emission mask (paper Eq. 15), mean over pixels.

    Args:
        rendered, photographed: (N, 3).
        alpha: (N,) emission mask; 1 where an emitter is known, which then does not count.
    """
    mixed = torch.lerp(rendered, photographed, alpha[:, None])
    return (tone_map(mixed) - tone_map(photographed)).square().sum(dim=1).mean()


def emission_loss(raw: torch.Tensor) -> torch.Tensor:
    """l_e without its weight: mean |MLP_emit| (paper Eq. 16)."""
    return raw.abs().mean()


def diffuse_loss(prediction: Prediction) -> torch.Tensor:
    """l_d without its weight: mean |1 - sigma| + |m| (paper Eq. 17)."""
    return ((1.0 - prediction.roughness).abs() + prediction.metallic.abs()).mean()


def semantic_loss(
    prediction: Prediction,
    positions: torch.Tensor,
    part: torch.Tensor,
    partners: torch.Tensor,
    sigma_albedo: float,
    sigma_position: float,
) -> torch.Tensor:
    """l_p without its weight, with the kernel w(x', x) of semantic masks (paper Eq. 20).

    Args:
        positions: (N, 3) in the unit cube.
        part: (N,) int64 semantic class; pixels with a negative one do not contribute.
        partners: (P,) int64 rows of the batch that serve as x'.
        sigma_albedo, sigma_position: standard deviations of the kernel in base colour and in position.
    """
    values = torch.stack([prediction.roughness, prediction.metallic], dim=1)
    color = prediction.base_color.detach()
    distance = torch.cdist(color, color[partners]).square() / (2.0 * sigma_albedo**2)
    distance += torch.cdist(positions, positions[partners]).square() / (2.0 * sigma_position**2)
    same = (part[:, None] == part[partners][None, :]) & (part[:, None] >= 0)
    weight = torch.exp(-distance) * same
    total = weight.sum(dim=1, keepdim=True)
    mean = (weight @ values.detach()[partners]) / total.clamp_min(1e-12)
    known = total[:, 0] > 1e-6
    return ((values - mean).abs().sum(dim=1) * known).mean()
