"""The estimated material fields of a run, which can be queried at any surface point, seen or unseen.

results/fields.npz holds the BRDF network with the typical values of the units, the box to which positions are
normalised and the cells that photographs saw; parts.npz holds the unit of each triangle and which units are
of one material.
Both are plain arrays without pickles.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np

from ..optics.brdf import set_masking
from ..parts.labels import NO_PART
from ..run.errors import FiptError
from ..run.run_files import PartArrays
from ..run.runfolder import RunFolder
from ..run.store import Gaps, read_arrays, write_arrays
from .confidence import UNIFORM_DEVIATION, confidence, errors_with_place
from .groups import Units
from .networks import Fields, brdf_network
from .reliability import PartDetail
from .seen import Box, SeenCells, fallback_values, seen_statistics

# Base colour, and roughness with metallic, among the five values of a point.
COLOR, MATERIAL = slice(0, 3), slice(3, 5)


@dataclass(frozen=True, eq=False)
class FieldArrays:
    """results/fields.npz: the network's weights, and arguments of `RoomFields`, of C cells and U units."""

    network: Mapping[str, np.ndarray]
    box_low: np.ndarray  # (3,)
    box_extent: float
    seen_keys: np.ndarray  # (C,) int
    seen_points: np.ndarray  # (C, 3)
    seen_part: np.ndarray  # (C,) int
    seen_errors: np.ndarray  # (C, 3)
    place: float = 0.0
    detail_median: Gaps | None = None  # (U, 3)
    detail_width: float | None = None
    detail_keys: np.ndarray | None = None  # (N,) int, of the nodes of a grid
    detail_sums: np.ndarray | None = None  # (N, 9)


class RoomFields:
    """Base colour, roughness and metallic on a room's surfaces, seen and unseen, and their confidence.

    Args:
        fields: the values on seen surfaces.
        units: of the mesh. If errors are given, points of a unit of one material have its median roughness
            and metallic.
        cells: where the photographs saw surfaces.
        errors: (C, 3) float32 standard errors of base colour, roughness and metallic in each cell
            (:func:`.cell_errors.cell_errors`); None if they are not known.
        place: standard deviation of the place of surfaces, metres; lowers confidence
            (:func:`.confidence.errors_with_place`).
        detail: of the base colours of units of one material, which is kept as far as it is reliable
            (:mod:`.reliability`); None to keep all of it.
    """

    def __init__(
        self,
        fields: Fields,
        units: Units,
        cells: SeenCells,
        errors: np.ndarray | None = None,
        place: float = 0.0,
        detail: PartDetail | None = None,
    ) -> None:
        self.fields, self.units, self.cells, self.place, self.detail = fields, units, cells, place, detail
        unknown = np.full((len(cells.keys), 3), UNIFORM_DEVIATION, np.float32)
        self.errors = unknown if errors is None else errors
        values = fields.query(cells.points, cells.part)
        self._statistics = seen_statistics(cells.points, cells.part, values, len(units.single))
        if detail is not None:
            known = np.isfinite(detail.median[:, 0])
            self._statistics.medians[known, COLOR] = detail.median[known]
        self._one_material = errors is not None and bool(units.single.any())

    def with_errors(self, errors: np.ndarray) -> RoomFields:
        """The same with other standard errors (C, 3)."""
        other = copy(self)
        other.errors = errors
        return other

    def query(
        self, positions: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The estimate at surface points; unseen ones get fallback values (:mod:`.seen`).

        Args:
            positions: (N, 3) world metres.
            triangles: (N,) int triangles of the room on which they lie.

        Returns:
            (base_color (N, 3), roughness (N,), metallic (N,)), float32; roughness is the paper's sigma.
        """
        part = self.units.triangle[triangles]
        place = self.cells.find(self.fields.box, positions, part)
        # Where no surface was seen at all, only the network is left.
        seen = place >= 0 if len(self.cells.keys) else np.ones(len(positions), bool)
        seen_values = self.fields.query(positions[seen], part[seen])
        if self.detail is not None:
            color = seen_values[:, COLOR], positions[seen], part[seen], self.fields.box
            seen_values[:, COLOR] = self.detail.shrink(*color)
        if self._one_material:
            single = self.units.is_single(part[seen])
            typical = fallback_values(positions[seen][single], part[seen][single], self._statistics)
            seen_values[single, MATERIAL] = typical[:, MATERIAL]
        values = np.empty((len(positions), seen_values.shape[1]), np.float32)
        values[seen] = seen_values
        values[~seen] = fallback_values(positions[~seen], part[~seen], self._statistics)
        if self.units.fixed is not None:
            fixed = np.append(self.units.fixed, [[np.nan] * 2], axis=0)[np.maximum(part, NO_PART)]
            values[:, MATERIAL] = np.where(np.isnan(fixed), values[:, MATERIAL], fixed)
        return values[:, :3], values[:, 3], values[:, 4]

    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(N, 3) float32 confidence of base colour, roughness and metallic at surface points; 0 where unseen.

        See :func:`.confidence.confidence`; arguments as in :meth:`query`.
        """
        place = self.cells.find(self.fields.box, positions, self.units.triangle[triangles])
        errors = errors_with_place(self.errors, self.place)
        of_cell = np.append(confidence(errors), np.zeros((1, 3), np.float32), axis=0)
        return of_cell[place]  # unseen points have -1, the last row

    @classmethod
    def load(cls, run: RunFolder) -> RoomFields:
        """Read results/fields.npz and parts.npz, and set the run's masking term G.

        Mitsuba's variant must be set before.

        Raises:
            FiptError: ``results-missing`` or ``file-damaged``.
        """
        settings = run.read()
        set_masking(settings.masking)
        for path in (run.fields_npz, run.parts_npz):
            if not path.exists():
                raise FiptError("results-missing.load", path=path)
        again = "Run the estimation again."
        parts = read_arrays(run.parts_npz, PartArrays, again)
        units = Units(parts.triangle_part, parts.single, parts.fixed)
        arrays = read_arrays(run.fields_npz, FieldArrays, again)
        try:
            network = brdf_network(settings, arrays.network, len(units.single))
        except (RuntimeError, KeyError) as error:  # the settings have changed since
            raise FiptError(
                "file-damaged.read-arrays", path=run.fields_npz, error=error, remedy=again
            ) from None
        median, width = arrays.detail_median, arrays.detail_width
        keys, sums = arrays.detail_keys, arrays.detail_sums
        detail = None
        if not (median is None or width is None or keys is None or sums is None):
            detail = PartDetail(median, float(width), keys, sums)
        box = Box(arrays.box_low.astype(np.float64), float(arrays.box_extent))
        cells = SeenCells(arrays.seen_keys, arrays.seen_points, arrays.seen_part)
        return cls(Fields(network, box), units, cells, arrays.seen_errors, float(arrays.place), detail)

    def save(self, run: RunFolder) -> None:
        """Write results/fields.npz and parts.npz."""
        network, box, units, detail = self.fields.network, self.fields.box, self.units, self.detail
        arrays = FieldArrays(
            {name: value.cpu().numpy() for name, value in network.state_dict().items()},
            box.low,
            box.extent,
            self.cells.keys,
            self.cells.points,
            self.cells.part,
            self.errors,
            self.place,
            *(() if detail is None else vars(detail).values()),
        )
        write_arrays(run.fields_npz, arrays)
        write_arrays(run.parts_npz, PartArrays(units.triangle, units.single, units.fixed))
