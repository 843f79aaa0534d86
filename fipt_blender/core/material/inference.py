# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network evaluated at world positions, in chunks of bounded memory."""

from __future__ import annotations

import numpy as np
import torch

from .networks import BrdfNetwork
from .seen import Box

CHUNK = 1 << 17  # points in one evaluation of the networks


class Fields:
    """The BRDF network at any world position, observed or not.

    Its values mean nothing where no photograph saw a surface; :class:`.fields.RoomFields` replaces them
    there.
    """

    def __init__(self, network: BrdfNetwork, box: Box) -> None:
        self.network, self.box = network, box
        self._device = next(network.parameters()).device

    @torch.no_grad()
    def query(self, positions: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(N, 5) float32 base colour, roughness (the paper's sigma) and metallic.

        Args:
            positions: (N, 3) world metres.
            units: (N,) int units on which they lie, negative for none.
        """
        result = np.empty((len(positions), 5), np.float32)
        for start in range(0, len(positions), CHUNK):
            rows = slice(start, start + CHUNK)
            inputs = torch.from_numpy(self.box.normalise(positions[rows]))
            unit = torch.from_numpy(units[rows].astype(np.int64))
            count = len(inputs)
            if len(positions) > CHUNK:  # pad the last chunk, so that all chunks share one kernel
                inputs = torch.nn.functional.pad(inputs, (0, 0, 0, CHUNK - count))
                unit = torch.nn.functional.pad(unit, (0, CHUNK - count))
            prediction = self.network(inputs.to(self._device), unit.to(self._device))
            result[rows] = prediction.values[:count].cpu().numpy()
        return result
