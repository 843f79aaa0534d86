# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated material fields of a finished run, to be queried at any surface point.

results/fields.npz holds the BRDF network's weights, the box it is normalised to and where the photographs
saw the room: plain arrays, no pickles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..device.variant import torch_device
from ..job.errors import FiptError
from ..job.runfolder import RunFolder, atomic_path
from ..job.settings import Settings
from .brdf import set_masking
from .losses import factorised_rendering
from .networks import BrdfNetwork, EmissionNetwork, emission_mask

CHUNK = 1 << 17
COVERAGE_RESOLUTION = 128
# Pixels in a coverage voxel at which it counts as fully seen, up to a factor 1 - 1/e.
FULLY_SEEN = 4.0


@dataclass(frozen=True)
class Box:
    """The cube to which positions are normalised: lowest corner and edge, metres."""

    low: np.ndarray
    extent: float

    def normalise(self, positions: np.ndarray) -> np.ndarray:
        """(N, 3) float32 positions in [0, 1] of world positions in metres."""
        return ((positions - self.low) / self.extent).astype(np.float32)


def room_box(bounds: tuple[np.ndarray, np.ndarray]) -> Box:
    """The cube around a room's bounds, a little larger."""
    low, high = bounds
    extent = float((high - low).max()) * 1.002
    return Box(low - 0.001 * extent, extent)


class Fields:
    """Base colour, roughness and metallic of surface points, and whether a photograph saw them."""

    def __init__(self, network: BrdfNetwork, box: Box, coverage: np.ndarray) -> None:
        self.network, self.box, self.coverage = network, box, coverage
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
            part = slice(start, start + CHUNK)
            inputs = torch.from_numpy(self.box.normalise(positions[part]))
            # One kernel for all chunks: pad the last one.
            padded = torch.zeros((CHUNK, 3)) if len(positions) > CHUNK else inputs
            padded[: len(inputs)] = inputs
            found = self.network(padded.to(self._device))
            count = len(inputs)
            base_color[part] = found.base_color[:count].cpu().numpy()
            roughness[part] = found.roughness[:count].cpu().numpy()
            metallic[part] = found.metallic[:count].cpu().numpy()
        return base_color, roughness, metallic

    def observed(self, positions: np.ndarray) -> np.ndarray:
        """(N,) float32 coverage: 0 where no photograph saw the surface, towards 1 with more pixels."""
        return self.coverage[coverage_cells(self.box, positions)]

    @classmethod
    def load(cls, run: RunFolder) -> Fields:
        """Read results/fields.npz and set the run's G; Mitsuba's variant is set already.

        Raises:
            FiptError: ``results-missing`` or ``results-damaged``.
        """
        settings = run.read()
        set_masking(settings.masking)
        if not run.fields_npz.exists():
            raise FiptError(
                "results-missing", f"{run.fields_npz} does not exist.", "Let the estimation finish first."
            )
        try:
            with np.load(run.fields_npz, allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
            network = BrdfNetwork(
                settings, int(arrays["hash_levels"]), torch.Generator(), torch.device(torch_device())
            )
            state = {
                name[len("network/") :]: torch.from_numpy(array)
                for name, array in arrays.items()
                if name.startswith("network/")
            }
            network.load_state_dict(state)
            box = Box(arrays["box_low"].astype(np.float64), float(arrays["box_extent"]))
            return cls(network, box, arrays["coverage"])
        except (KeyError, ValueError, OSError, RuntimeError) as error:
            raise FiptError(
                "results-damaged", f"{run.fields_npz} can't be read ({error}).", "Run the estimation again."
            ) from None

    def save(self, run: RunFolder) -> None:
        """Write results/fields.npz."""
        state = {f"network/{name}": value.cpu().numpy() for name, value in self.network.state_dict().items()}
        with atomic_path(run.fields_npz) as temporary:
            np.savez(
                temporary,
                hash_levels=len(self.network.grid.resolutions),
                box_low=self.box.low,
                box_extent=self.box.extent,
                coverage=self.coverage,
                **state,
            )


def new_networks_generator(settings: Settings) -> torch.Generator:
    """The generator of initial weights: on the CPU, so that all devices start alike."""
    return torch.Generator().manual_seed(settings.seed)


def coverage_cells(box: Box, positions: np.ndarray) -> np.ndarray:
    """(N,) int64 flat index into the coverage grid."""
    cell = (box.normalise(positions) * COVERAGE_RESOLUTION).astype(np.int64)
    cell = np.clip(cell, 0, COVERAGE_RESOLUTION - 1)
    return (cell[:, 0] * COVERAGE_RESOLUTION + cell[:, 1]) * COVERAGE_RESOLUTION + cell[:, 2]


def count_coverage(box: Box, positions: np.ndarray) -> np.ndarray:
    """(R^3,) float32 coverage grid from all positions that pixels saw."""
    count = np.zeros(COVERAGE_RESOLUTION**3, np.int64)
    for start in range(0, len(positions), CHUNK):
        cells = coverage_cells(box, positions[start : start + CHUNK])
        count += np.bincount(cells, minlength=len(count))
    return (1.0 - np.exp(-count / FULLY_SEEN)).astype(np.float32)


@torch.no_grad()
def mask_at(network: EmissionNetwork, box: Box, positions: np.ndarray) -> np.ndarray:
    """Emission mask alpha (N,) float32 at (N, 3) world positions; fitted jointly, emission L_e (N, 3)."""
    device = next(network.parameters()).device
    found = []
    for start in range(0, max(len(positions), 1), CHUNK):
        inputs = torch.from_numpy(box.normalise(positions[start : start + CHUNK])).to(device)
        raw = network(inputs)
        value = emission_mask(raw) if network.outputs == 1 else torch.relu(raw)
        found.append(value.cpu().numpy())
    return np.concatenate(found)


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
    """(len(rows), 3) float32 reflected radiance L_r (paper Eq. 5) of some pixels.

    Args:
        position: (N, 3) world positions of all pixels; memory-mapped arrays will do.
        diffuse, specular: their shadings (N, 3) and (N, K, 2, 3), at the roughness `levels`.
        rows: (R,) pixels wanted.
    """
    device = next(network.parameters()).device
    level = torch.from_numpy(levels).to(device)
    result = np.empty((len(rows), 3), np.float32)
    for start in range(0, len(rows), CHUNK):
        part = rows[start : start + CHUNK]
        arrays = (box.normalise(np.asarray(position[part])), diffuse[part], specular[part])
        inputs = [torch.from_numpy(np.asarray(array, np.float32)).to(device) for array in arrays]
        value = factorised_rendering(network(inputs[0]), inputs[1], inputs[2], level)
        result[start : start + len(part)] = value.cpu().numpy()
    return result
