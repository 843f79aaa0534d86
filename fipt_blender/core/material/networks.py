"""The networks of stage 2 (paper Eq. 12 to 14, supplementary "Network architecture").

MLP_brdf maps a position to base colour, roughness and metallic: a hash grid and two hidden layers of 64. Here
it adds detail to the typical values of each unit (a part, or what takes its place) instead of finding them.
MLP_emit maps it to the emission mask.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from ..device.variant import torch_device
from ..run.stage_settings import NetworkSettings, Seeded
from .hashgrid import HashGrid
from .seen import Box, unit_medians

# Typical values are kept this far from 0 and 1, where the sigmoid's slope would leave nothing to learn.
_INSIDE = 0.005
# Initial weights of the last layer, relative to those of the others: the network starts near typical values.
_FIRST_DETAIL = 0.1
CHUNK = 1 << 17  # points in one evaluation of the networks


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


def brdf_network(settings: NetworkSettings, weights: Mapping[str, np.ndarray], units: int) -> BrdfNetwork:
    """The network of so many units with stored weights, on the device.

    Raises:
        KeyError, IndexError, ValueError, RuntimeError: where they are those of another network.
    """
    levels = weights["mlp.0.weight"].shape[1] // settings.hash_features
    if levels > settings.hash_levels:
        raise ValueError(f"it has {levels} levels, the settings {settings.hash_levels}")
    typical, device = np.zeros((units + 1, 5)), torch.device(torch_device())
    network = BrdfNetwork(settings, levels, typical, network_generator(settings), device)
    network.load_state_dict(tensors(weights))
    return network


def tensors(weights: Mapping[str, np.ndarray]) -> dict[str, torch.Tensor]:
    """Weights by name, as torch takes them."""
    return {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}


class Fields:
    """The BRDF network at any world position, observed or not.

    Its values mean nothing where no photograph saw a surface; :class:`.fields.RoomFields` replaces them
    there. Points are evaluated in chunks of bounded memory.
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
