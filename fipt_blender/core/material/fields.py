# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated material fields of a finished run, to be queried at any surface point.

results/fields.npz holds the BRDF network's weights, the box it is normalised to and where the photographs
saw the room, parts.npz the unit of each triangle and which units are of one material. Plain arrays, no
pickles.
"""

from __future__ import annotations

import numpy as np
import torch

from ..device.variant import torch_device
from ..job.errors import FiptError
from ..job.runfolder import RunFolder, atomic_path
from ..job.settings import Settings
from ..scene.labels import NO_PART
from .brdf import set_masking
from .confidence import UNKNOWN, confidence
from .groups import Units
from .losses import factorised_rendering
from .networks import BrdfNetwork, EmissionNetwork, emission_mask
from .part_prior import drawn_to_parts, part_priors
from .seen import Box, SeenCells, seen_statistics, stand_ins

CHUNK = 1 << 17
# Base colour, roughness and metallic among the values of a point.
COLUMNS = (slice(0, 3), slice(3, 4), slice(4, 5))
# Least standard error of base colour, and what the network smooths away of roughness and metallic at borders.
LEAST_ERROR = 0.02
SMOOTHING = 0.2


class Fields:
    """What the network says about positions, wherever they are.

    Where no photograph looked that means nothing: :class:`RoomFields` knows where.
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


class RoomFields:
    """Base colour, roughness and metallic of a room's surfaces, seen and unseen, and what was seen of them.

    Args:
        fields: asked where photographs saw the surface.
        units: of the mesh; values with known errors are drawn to those of their unit where that is of one
            material (:mod:`.part_prior`).
        cells: where that is.
        errors: (K, 3) float32 standard errors of base colour, roughness and metallic in each of them;
            unknown where not given.
    """

    def __init__(
        self,
        fields: Fields,
        units: Units,
        cells: SeenCells,
        errors: np.ndarray | None = None,
    ) -> None:
        self.fields, self.units, self.cells = fields, units, cells
        self.errors = np.full((len(cells.keys), 3), UNKNOWN, np.float32) if errors is None else errors
        values = _columns(fields.query(cells.points))
        self._statistics = seen_statistics(cells.points, cells.part, values)
        self._priors = []
        if errors is not None and units.single.any():
            one = np.where(units.is_single(cells.part), cells.part, NO_PART)
            own = zip(COLUMNS, _spreads(errors), strict=True)
            self._priors = [part_priors(values[:, columns], spread, one) for columns, spread in own]

    def query(
        self, positions: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The estimate at surface points; unseen ones get what stands in for them (:mod:`.seen`).

        Args:
            positions: (N, 3) world metres.
            triangles: (N,) int of the room, on which they lie.

        Returns:
            (base_color (N, 3), roughness (N,), metallic (N,)), float32; roughness is the paper's sigma.
        """
        part = self.units.triangle[triangles]
        place = self.cells.find(self.fields.box, positions, part)
        # Where no surface was seen at all there is nothing else to ask.
        seen = place >= 0 if len(self.cells.keys) else np.ones(len(positions), bool)
        known = _columns(self.fields.query(positions[seen]))
        if self._priors:
            own = zip(COLUMNS, _spreads(self.errors[place[seen]]), self._priors, strict=True)
            for columns, spread, prior in own:
                known[:, columns] = drawn_to_parts(known[:, columns], spread, part[seen], prior)
        values = np.empty((len(positions), known.shape[1]), np.float32)
        values[seen] = known
        values[~seen] = stand_ins(positions[~seen], part[~seen], self._statistics)
        return values[:, :3], values[:, 3], values[:, 4]

    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(N, 3) float32, how well base colour, roughness and metallic are known there; 0 where unseen.

        See :func:`.confidence.confidence`.
        """
        place = self.cells.find(self.fields.box, positions, self.units.triangle[triangles])
        known = np.append(confidence(self.errors), np.zeros((1, 3), np.float32), axis=0)
        return known[place]  # -1 is the last row

    @classmethod
    def load(cls, run: RunFolder) -> RoomFields:
        """Read results/fields.npz and parts.npz and set the run's G; Mitsuba's variant is set already.

        Raises:
            FiptError: ``results-missing`` or ``results-damaged``.
        """
        settings = run.read()
        set_masking(settings.masking)
        for path in (run.fields_npz, run.parts_npz):
            if not path.exists():
                raise FiptError(
                    "results-missing", f"{path} does not exist.", "Let the estimation finish first."
                )
        try:
            with np.load(run.fields_npz, allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
            with np.load(run.parts_npz, allow_pickle=False) as data:
                units = Units(data["triangle_part"], data["single"])
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
            cells = SeenCells(arrays["seen_keys"], arrays["seen_points"], arrays["seen_part"])
            return cls(Fields(network, box), units, cells, arrays["seen_errors"])
        except (KeyError, ValueError, OSError, RuntimeError) as error:
            raise FiptError(
                "results-damaged", f"{run.fields_npz} can't be read ({error}).", "Run the estimation again."
            ) from None

    def save(self, run: RunFolder) -> None:
        """Write results/fields.npz and parts.npz."""
        network, box = self.fields.network, self.fields.box
        state = {f"network/{name}": value.cpu().numpy() for name, value in network.state_dict().items()}
        with atomic_path(run.fields_npz) as temporary:
            np.savez(
                temporary,
                hash_levels=len(network.grid.resolutions),
                box_low=box.low,
                box_extent=box.extent,
                seen_keys=self.cells.keys,
                seen_points=self.cells.points,
                seen_part=self.cells.part,
                seen_errors=self.errors,
                **state,
            )
        with atomic_path(run.parts_npz) as temporary:
            np.savez(temporary, triangle_part=self.units.triangle, single=self.units.single)


def _spreads(errors: np.ndarray) -> tuple[np.ndarray, ...]:
    """Standard errors (N,) of the values in COLUMNS within their part, of errors (N, 3) of cells.

    Roughness and metallic have one value a part, so theirs are no errors of single points. What differs from
    point to point is the network's doing, at borders above all.
    """
    smoothing = np.full(len(errors), SMOOTHING)
    return np.maximum(errors[:, 0].astype(float), LEAST_ERROR), smoothing, smoothing


def _columns(found: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """(N, 5) float32 of base colour, roughness and metallic."""
    return np.column_stack(found).astype(np.float32)


def new_networks_generator(settings: Settings) -> torch.Generator:
    """The generator of initial weights: on the CPU, so that all devices start alike."""
    return torch.Generator().manual_seed(settings.seed)


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
