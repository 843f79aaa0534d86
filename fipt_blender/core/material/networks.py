# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The two networks of stage 2 (paper Eq. 14, supplementary "Network architecture").

MLP_brdf maps a position to base colour, roughness and metallic: a hash grid and two hidden layers of 64.
MLP_emit maps it to the emission mask: a positional encoding with 10 bands and six hidden layers of 128, with
one skip connection in the middle.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch

from ..run.settings import Settings
from .hashgrid import HashGrid


@dataclass
class Prediction:
    """Output of MLP_brdf at N points.

    Attributes:
        base_color: (N, 3) in [0, 1].
        roughness: (N,) in [roughness_min, 1].
        metallic: (N,) in [0, 1].
    """

    base_color: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor


class BrdfNetwork(torch.nn.Module):
    """Base colour, roughness and metallic of positions in the unit cube."""

    def __init__(
        self, settings: Settings, levels: int, generator: torch.Generator, device: torch.device
    ) -> None:
        super().__init__()
        self.lowest = settings.roughness_min
        self.grid = HashGrid(
            levels,
            settings.hash_features,
            settings.hash_log2_size,
            settings.hash_base_resolution,
            settings.hash_growth,
            generator,
            device,
        )
        widths = [self.grid.width] + [settings.brdf_width] * settings.brdf_depth + [5]
        self.mlp = _mlp(widths, generator, device)

    def forward(self, positions: torch.Tensor) -> Prediction:
        """Evaluate at (N, 3) positions in [0, 1]."""
        x = self.grid(positions)
        for layer in self.mlp[:-1]:
            x = torch.relu(layer(x))
        value = torch.sigmoid(self.mlp[-1](x))
        roughness = self.lowest + (1.0 - self.lowest) * value[:, 3]
        return Prediction(value[:, :3], roughness, value[:, 4])


class EmissionNetwork(torch.nn.Module):
    """Raw emission mask of positions in the unit cube; alpha = 1 - exp(-ReLU(raw)) (paper Eq. 14).

    Where emission is fitted jointly, the network has three outputs instead: L_e = ReLU(raw).
    """

    def __init__(self, settings: Settings, generator: torch.Generator, device: torch.device) -> None:
        super().__init__()
        self.bands = settings.emission_bands
        encoded = 3 + 6 * self.bands
        width, depth = settings.emission_width, settings.emission_depth
        self.skip = depth // 2
        layers = []
        inputs = encoded
        for i in range(depth):
            layers.append(_linear(inputs, width, generator, device))
            inputs = width + encoded if i + 1 == self.skip else width
        self.outputs = 3 if settings.emission == "joint" else 1
        layers.append(_linear(inputs, self.outputs, generator, device))
        self.layers = torch.nn.ModuleList(layers)

    def forward(self, positions: torch.Tensor) -> torch.Tensor:
        """Raw values (N,), or (N, 3) where emission is fitted jointly, at (N, 3) positions in [0, 1]."""
        encoded = positional_encoding(positions * 2.0 - 1.0, self.bands)
        x = encoded
        for i, layer in enumerate(self.layers[:-1]):
            x = torch.relu(layer(x))
            if i + 1 == self.skip:
                x = torch.cat([x, encoded], dim=1)
        raw = self.layers[-1](x)
        return raw if self.outputs == 3 else raw[:, 0]


@dataclass(frozen=True)
class Networks:
    """The two networks of stage 2, on one device."""

    brdf: BrdfNetwork
    emission: EmissionNetwork

    @property
    def device(self) -> torch.device:
        """Device of all parameters."""
        return next(self.brdf.parameters()).device


def networks_generator(settings: Settings) -> torch.Generator:
    """The generator of the initial weights: on the CPU, so that they are the same on all devices."""
    return torch.Generator().manual_seed(settings.seed)


def emission_mask(raw: torch.Tensor) -> torch.Tensor:
    """alpha = 1 - exp(-ReLU(raw)) (paper Eq. 14)."""
    return 1.0 - torch.exp(-torch.relu(raw))


def positional_encoding(positions: torch.Tensor, bands: int) -> torch.Tensor:
    """(N, 3 + 6 bands): positions (N, 3) in [-1, 1], and sines and cosines of pi 2^k times them (NeRF)."""
    octaves = torch.pi * 2.0 ** torch.arange(bands, device=positions.device, dtype=positions.dtype)
    angles = (positions[:, :, None] * octaves).reshape(len(positions), -1)
    return torch.cat([positions, torch.sin(angles), torch.cos(angles)], dim=1)


def useful_hash_levels(settings: Settings, extent: float, footprint: float) -> int:
    """Number of hash grid levels whose cells are at least half a pixel wide, at most settings.hash_levels.

    Less than a pixel sees each finer cell, so finer levels only learn noise.

    Args:
        extent: edge of the normalised cube, metres.
        footprint: median width of a pixel on the surfaces, metres.
    """
    levels = 1
    while levels < settings.hash_levels:
        resolution = settings.hash_base_resolution * settings.hash_growth**levels
        if extent / resolution < 0.5 * footprint:
            break
        levels += 1
    return levels


def _mlp(widths: list[int], generator: torch.Generator, device: torch.device) -> torch.nn.ModuleList:
    pairs = itertools.pairwise(widths)
    return torch.nn.ModuleList([_linear(a, b, generator, device) for a, b in pairs])


def _linear(inputs: int, outputs: int, generator: torch.Generator, device: torch.device) -> torch.nn.Linear:
    """A linear layer with He-uniform weights from `generator` and zero bias."""
    layer = torch.nn.Linear(inputs, outputs, device=device)
    bound = (6.0 / inputs) ** 0.5 if outputs > 1 else (1.0 / inputs) ** 0.5
    weight = (torch.rand((outputs, inputs), generator=generator) * 2.0 - 1.0) * bound
    with torch.no_grad():
        layer.weight.copy_(weight)
        layer.bias.zero_()
    return layer
