# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network of stage 2 (paper Eq. 14, supplementary "Network architecture").

MLP_brdf maps a position to base colour, roughness and metallic: a hash grid and two hidden layers of 64. Here
it adds detail to the typical values of each unit (a part, or what takes its place) instead of finding them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch

from ..run.stage_settings import NetworkSettings, Seeded
from .hashgrid import HashGrid
from .seen import unit_medians

# Typical values are kept this far from 0 and 1, where the sigmoid's slope would leave nothing to learn.
_INSIDE = 0.005
# Initial weights of the last layer, relative to those of the others: the network starts near typical values.
_FIRST_DETAIL = 0.1


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

    @property
    def values(self) -> torch.Tensor:
        """(N, 5) base colour, roughness and metallic."""
        return torch.cat([self.base_color, self.roughness[:, None], self.metallic[:, None]], dim=1)


class BrdfNetwork(torch.nn.Module):
    """Base colour, roughness and metallic of positions in the unit cube on units of the mesh.

    Args:
        levels: of the hash grid.
        typical: (U + 1, 5) typical base colour, roughness and metallic of each unit, to which the network
            adds before the sigmoid; the last row is of surfaces without a unit.
    """

    typical: torch.Tensor

    def __init__(
        self,
        settings: NetworkSettings,
        levels: int,
        typical: np.ndarray,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        super().__init__()
        self.lowest = settings.roughness_min
        values = torch.from_numpy(typical.astype(np.float32))
        values[:, 3] = (values[:, 3] - self.lowest) / (1.0 - self.lowest)
        self.register_buffer("typical", torch.logit(values, eps=_INSIDE).to(device))
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
        layers = (linear(a, b, generator, device) for a, b in itertools.pairwise(widths))
        self.mlp = torch.nn.ModuleList(layers)
        with torch.no_grad():
            self.mlp[-1].weight.mul_(_FIRST_DETAIL)

    def forward(self, positions: torch.Tensor, units: torch.Tensor) -> Prediction:
        """Evaluate at (N, 3) positions in [0, 1] on units (N,) int64; negative ones stand for none."""
        units = torch.where(units >= 0, units, len(self.typical) - 1)
        x = self.grid(positions, units)
        for layer in self.mlp[:-1]:
            x = layer(x).relu_()
        value = torch.sigmoid(self.mlp[-1](x) + self.typical[units])
        roughness = self.lowest + (1.0 - self.lowest) * value[:, 3]
        return Prediction(value[:, :3], roughness, value[:, 4])


def network_generator(settings: Seeded) -> torch.Generator:
    """The generator of the initial weights: on the CPU, so that they are the same on all devices."""
    return torch.Generator().manual_seed(settings.seed)


def typical_values(values: np.ndarray, unit: np.ndarray, units: int) -> np.ndarray:
    """(units + 1, C) median of the values of each unit, and of all values for those without and at the end.

    Args:
        values: (N, C).
        unit: (N,) int, negative for none.
    """
    medians, every = unit_medians(values, unit, units), np.median(values, axis=0)
    return np.vstack([np.where(np.isnan(medians), every, medians), every])


def useful_hash_levels(settings: NetworkSettings, extent: float, footprint: float) -> int:
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


def linear(inputs: int, outputs: int, generator: torch.Generator, device: torch.device) -> torch.nn.Linear:
    """A linear layer with He-uniform weights from `generator` and zero bias."""
    layer = torch.nn.Linear(inputs, outputs, device=device)
    bound = (6.0 / inputs) ** 0.5 if outputs > 1 else (1.0 / inputs) ** 0.5
    weight = (torch.rand((outputs, inputs), generator=generator) * 2.0 - 1.0) * bound
    with torch.no_grad():
        layer.weight.copy_(weight)
        layer.bias.zero_()
    return layer
