"""The factorised rendering and all terms of the loss (paper Eq. 5, 8 and 15 to 20)."""

from __future__ import annotations

import torch

from ..optics import factorised
from .networks import Prediction


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


def factorised_rendering(
    prediction: Prediction, diffuse: torch.Tensor, specular: torch.Tensor, levels: torch.Tensor
) -> torch.Tensor:
    """L_r = kd L_d + ks L_s0 + L_s1 (paper Eq. 5), (N, 3)."""
    kd, ks = reflectances(prediction)
    s0, s1 = interpolate_specular(specular, prediction.roughness, levels)
    return factorised.reflected_radiance(kd, ks, diffuse, s0, s1)


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """The tone mapping of Munkberg et al. 2022: the sRGB transfer function of log(1 + x)."""
    x = torch.log1p(radiance.clamp_min(0.0))
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(1e-7) ** (1.0 / 2.4) - 0.055)


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


def part_loss(prediction: Prediction, material: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """l_p without its weight: L1 distance of roughness and metallic from those of the part (paper Eq. 18).

    The paper's sigma' and m' are means over the part's pixels in the batch, weighted by highlights (Eq. 19).
    Here they are the part's closed-form estimate, to which all its pixels contribute.

    Args:
        material: (N, 2) sigma' and m'.
        known: (N,) bool, whether a pixel belongs to a part.
    """
    return ((prediction.values[:, 3:] - material).abs().sum(dim=1) * known).mean()


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
