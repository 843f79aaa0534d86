# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The networks evaluated at world positions and at pixels, in chunks of bounded memory."""

from __future__ import annotations

import numpy as np
import torch

from .losses import factorised_rendering
from .networks import BrdfNetwork, EmissionNetwork, emission_mask
from .seen import Box

CHUNK = 1 << 17


class Fields:
    """The BRDF network at any world position, observed or not.

    Its values mean nothing where no photograph saw a surface; :class:`.fields.RoomFields` replaces them
    there.
    """

    def __init__(self, network: BrdfNetwork, box: Box) -> None:
        self.network, self.box = network, box
        self._device = next(network.parameters()).device

    @torch.no_grad()
    def query(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate the network.

        Args:
            positions: (N, 3) world metres.

        Returns:
            (base_color (N, 3), roughness (N,), metallic (N,)), float32; roughness is the paper's sigma.
        """
        base_color = np.empty((len(positions), 3), np.float32)
        roughness = np.empty(len(positions), np.float32)
        metallic = np.empty(len(positions), np.float32)
        for start in range(0, len(positions), CHUNK):
            rows = slice(start, start + CHUNK)
            inputs = torch.from_numpy(self.box.normalise(positions[rows]))
            # Pad the last chunk, so that all chunks share one kernel.
            padded = torch.zeros((CHUNK, 3)) if len(positions) > CHUNK else inputs
            padded[: len(inputs)] = inputs
            prediction = self.network(padded.to(self._device))
            count = len(inputs)
            base_color[rows] = prediction.base_color[:count].cpu().numpy()
            roughness[rows] = prediction.roughness[:count].cpu().numpy()
            metallic[rows] = prediction.metallic[:count].cpu().numpy()
        return base_color, roughness, metallic


@torch.no_grad()
def mask_at(network: EmissionNetwork, box: Box, positions: np.ndarray) -> np.ndarray:
    """(N,) float32 emission mask alpha at world positions (N, 3); L_e (N, 3) if fitted jointly."""
    device = next(network.parameters()).device
    values = []
    for start in range(0, max(len(positions), 1), CHUNK):
        inputs = torch.from_numpy(box.normalise(positions[start : start + CHUNK])).to(device)
        raw = network(inputs)
        value = emission_mask(raw) if network.outputs == 1 else torch.relu(raw)
        values.append(value.cpu().numpy())
    return np.concatenate(values)


@torch.no_grad()
def render_pixels(
    network: BrdfNetwork,
    box: Box,
    position: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    levels: np.ndarray,
    rows: np.ndarray,
) -> np.ndarray:
    """(R, 3) float32 reflected radiance L_r (paper Eq. 5) of the pixels `rows` (R,).

    Args:
        position: (N, 3) world positions of all pixels; this and the shadings may be memory-mapped.
        diffuse, specular: shadings (N, 3) and (N, K, 2, 3) of all pixels, at the roughness `levels` (K,).
    """
    device = next(network.parameters()).device
    level = torch.from_numpy(levels).to(device)
    result = np.empty((len(rows), 3), np.float32)
    for start in range(0, len(rows), CHUNK):
        chunk = rows[start : start + CHUNK]
        arrays = (box.normalise(np.asarray(position[chunk])), diffuse[chunk], specular[chunk])
        inputs = [torch.from_numpy(np.asarray(array, np.float32)).to(device) for array in arrays]
        value = factorised_rendering(network(inputs[0]), inputs[1], inputs[2], level)
        result[start : start + len(chunk)] = value.cpu().numpy()
    return result
