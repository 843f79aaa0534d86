# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network of stage 2 (paper Eq. 14, supplementary "Network architecture").

It maps a position to base colour: a hash grid and two hidden layers of 64. It adds detail to the typical
colour of each unit (a part, or what takes its place) instead of finding it.
"""

from __future__ import annotations

import itertools

import numpy as np
import torch

from ..run.settings import Settings
from ..scene.grouped import grouped_weighted_median
from .hashgrid import HashGrid

# Typical values are kept this far from 0 and 1, where the sigmoid's slope would leave nothing to learn.
_INSIDE = 0.005
# Initial weights of the last layer, relative to those of the others: the network starts near typical values.
_FIRST_DETAIL = 0.1


class ColorNetwork(torch.nn.Module):
    """Base colour of positions in the unit cube on units of the mesh.

    Args:
        levels: of the hash grid.
        typical: (U + 1, 3) typical base colour of each unit, to which the network adds before the sigmoid;
            the last row is of surfaces without a unit.
    """

    typical: torch.Tensor

    def __init__(
        self,
        settings: Settings,
        levels: int,
        typical: np.ndarray,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        super().__init__()
        values = torch.from_numpy(typical.astype(np.float32))
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
        widths = [self.grid.width] + [settings.brdf_width] * settings.brdf_depth + [typical.shape[1]]
        pairs = itertools.pairwise(widths)
        self.mlp = torch.nn.ModuleList([linear(a, b, generator, device) for a, b in pairs])
        with torch.no_grad():
            self.mlp[-1].weight.mul_(_FIRST_DETAIL)

    def forward(self, positions: torch.Tensor, units: torch.Tensor) -> torch.Tensor:
        """(N, 3) base colours at (N, 3) positions in [0, 1] on units (N,) int64, negative for none."""
        units = torch.where(units >= 0, units, len(self.typical) - 1)
        x = self.grid(positions, units)
        for layer in self.mlp[:-1]:
            x = layer(x).relu_()
        return torch.sigmoid(self.mlp[-1](x) + self.typical[units])


def network_generator(settings: Settings) -> torch.Generator:
    """The generator of the initial weights: on the CPU, so that they are the same on all devices."""
    return torch.Generator().manual_seed(settings.seed)


def typical_colors(color: np.ndarray, weight: np.ndarray, unit: np.ndarray, units: int) -> np.ndarray:
    """(units + 1, 3) weighted median of each unit's colours, and of all for those without and at the end.

    Args:
        color: (N, 3). weight: (N,).
        unit: (N,) int, negative for none.
    """
    seen = np.bincount(unit[unit >= 0], minlength=units) > 0
    result = np.empty((units + 1, 3))
    for column, medians in zip(color.T, result.T, strict=True):
        medians[:] = grouped_weighted_median(column, weight, np.zeros(len(unit), np.int64), 1)
        medians[:-1][seen] = grouped_weighted_median(
            column, weight * (unit >= 0), np.maximum(unit, 0), units
        )[seen]
    return result


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


def linear(inputs: int, outputs: int, generator: torch.Generator, device: torch.device) -> torch.nn.Linear:
    """A linear layer with He-uniform weights from `generator` and zero bias."""
    layer = torch.nn.Linear(inputs, outputs, device=device)
    bound = (6.0 / inputs) ** 0.5 if outputs > 1 else (1.0 / inputs) ** 0.5
    weight = (torch.rand((outputs, inputs), generator=generator) * 2.0 - 1.0) * bound
    with torch.no_grad():
        layer.weight.copy_(weight)
        layer.bias.zero_()
    return layer
