# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The emission mask of stage 2 (paper Eq. 12 to 14)."""

from __future__ import annotations

import torch

from .networks import linear


class EmissionNetwork(torch.nn.Module):
    """Raw emission mask of positions in the unit cube; alpha = 1 - exp(-ReLU(raw)) (paper Eq. 14).

    A positional encoding with 10 bands and six hidden layers of 128, with one skip connection in the middle.
    """

    def __init__(
        self, generator: torch.Generator, device: torch.device, width: int = 128, depth: int = 6
    ) -> None:
        super().__init__()
        self.bands = 10
        encoded = 3 + 6 * self.bands
        self.skip = depth // 2
        layers = []
        inputs = encoded
        for i in range(depth):
            layers.append(linear(inputs, width, generator, device))
            inputs = width + encoded if i + 1 == self.skip else width
        layers.append(linear(inputs, 1, generator, device))
        self.layers = torch.nn.ModuleList(layers)

    def forward(self, positions: torch.Tensor) -> torch.Tensor:
        """Raw values (N,) at (N, 3) positions in [0, 1]."""
        encoded = positional_encoding(positions * 2.0 - 1.0, self.bands)
        x = encoded
        for i, layer in enumerate(self.layers[:-1]):
            x = torch.relu(layer(x))
            if i + 1 == self.skip:
                x = torch.cat([x, encoded], dim=1)
        return self.layers[-1](x)[:, 0]


def emission_mask(raw: torch.Tensor) -> torch.Tensor:
    """alpha = 1 - exp(-ReLU(raw)) (paper Eq. 14)."""
    return 1.0 - torch.exp(-torch.relu(raw))


def positional_encoding(positions: torch.Tensor, bands: int) -> torch.Tensor:
    """(N, 3 + 6 bands): positions (N, 3) in [-1, 1], and sines and cosines of pi 2^k times them (NeRF)."""
    octaves = torch.pi * 2.0 ** torch.arange(bands, device=positions.device, dtype=positions.dtype)
    angles = (positions[:, :, None] * octaves).reshape(len(positions), -1)
    return torch.cat([positions, torch.sin(angles), torch.cos(angles)], dim=1)
