# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of one estimation: what its stages have computed so far, and how that is read back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from ..checks.view_check import ViewCheck
from ..device.variant import torch_device
from ..light.baking import ShadingStore, open_shadings
from ..light.cache import pool
from ..light.emitter_surfaces import EmitterSurfaces, emitter_surfaces
from ..light.emitters import EmitterPixels, Fixture, bright_triangles, emitter_table, group_fixtures
from ..light.observations import Observations
from ..light.presumed import presume_lamps
from ..light.shadings import roughness_levels
from ..material.closed_form import CellEstimate, TrainingData
from ..material.emission_mask import EmissionNetwork
from ..material.groups import Units
from ..material.hints import SurfaceHints, place_hints
from ..material.inference import Fields
from ..material.networks import BrdfNetwork, network_generator
from ..material.seen import SeenCells, fallback_values, find_seen_cells, room_box, seen_statistics
from ..material.training import Networks
from ..material.training_input import hinted_units, material_units
from ..optics.lights import EmitterTable
from ..parts.labels import NO_PART, Parts, choose_parts, room_pieces
from ..pixels.grouped import place_of
from ..pixels.store import LEFT_OUT, PixelStore, open_pixels
from ..run.arrays import check_layouts
from ..run.checkpoints import SHADINGS
from ..run.errors import FiptError
from ..run.hints import Hint
from ..run.messages import Reporter, peak_memory_gb
from ..run.per_view import LocalWorkers, Workers
from ..run.run_files import ScanHoles
from ..run.shapes import Layout
from ..run.threads import cached_property
from .hinted import hint_facts
from .input import EstimationInput

Facts = dict[str, Any]  # what stages.json keeps of a stage; JSON-serialisable

# What the checkpoint of a closed-form estimate holds; see `EstimationState._save_estimate`.
_ESTIMATE_ARRAYS: dict[str, Layout] = {
    "probability": ("f", ("T",)),
    "diffuse": ("f", ("M", 3)),
    "materials": ("f", ("M", 5)),
    "unit": ("i", ("T",)),
    "single": ("b", ("U",)),
    "fixed": ("f", ("F", 2)),
}


class EstimationState:
    """Intermediate results of one estimation.

    Args:
        given: its input, whose attributes are those of the state, too.
        reporter: gets stages, progress and warnings.
        workers: who does the work that each view needs for itself; None: this process.

    Attributes:
        pixels: all pixels of the training views, with the surface points that they see.
        scale: median radiance of the photographs; all radiance below is in this unit.
        view_check: views that were left out or corrected.
        photometry: what was found of photographs that are not HDR; empty without any.
        parts: of the room's triangles.
        hints: those that are honoured now, on the mesh; None without any.
        observations: what follows from the pixels before any estimate: cache, environment; divided by hints.
        brdf: the BRDF network of stage 2.
        units, cells: surfaces of one material, and where pixels saw them.
        fixtures: the emitters found so far.
        probability: (T,) float32 of each triangle to emit.
        diffuse: (M * 6, 3) float16 mean L_d of each cache entry in the last closed-form estimate.
        materials: (M * 6, 5) float32 base colour, roughness and metallic of each entry in that estimate. Both
            have no rows where no refinement follows it.
    """

    def __init__(self, given: EstimationInput, reporter: Reporter, workers: Workers | None = None) -> None:
        self.folder, self.settings, self.reporter = given.folder, given.settings, reporter
        self.plan, self.views, self.far_off, self.room = given.plan, given.views, given.far_off, given.room
        self.holes, self.checkpoints = given.holes, given.checkpoints
        self.told, self.told_again, self.light_again = given.told, given.told_again, given.light_again
        self.workers = workers or LocalWorkers()
        self.device = torch.device(torch_device())
        levels = (
            self.settings.roughness_levels,
            self.settings.roughness_min,
            self.settings.roughness_spacing,
        )
        self.levels = roughness_levels(*levels)
        self.box = room_box(self.room.bounds)
        self.hints: SurfaceHints | None = None
        self.pixels: PixelStore
        self.scale = 1.0
        self.view_check = ViewCheck()
        self.photometry: dict[str, Any] = {}
        self.parts: Parts
        self._observed: Observations
        self.observations: Observations
        self.brdf: BrdfNetwork
        self.units = Units(np.zeros(0, np.int32), np.zeros(0, bool))
        self.cells: SeenCells
        self.fixtures: list[Fixture] = []
        self.probability = np.zeros(len(self.room.triangles), np.float32)
        self.diffuse: np.ndarray
        self.materials: np.ndarray
        self._shadings = SHADINGS
        self._units_before: Units | None = None
        self._input: tuple[TrainingData, CellEstimate] | None = None

    # Pixels and shadings

    def _load_pixels(self) -> None:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views)
        self.scale = float(self.checkpoints.recall("scale"))
        self.photometry = dict(self.checkpoints.recall("photometry"))
        try:
            self.view_check = ViewCheck(**self.checkpoints.recall("view_check"))
        except TypeError as error:
            text = f"What the check of the views found can't be read ({error})."
            raise FiptError("file-damaged", text, "Start the estimation again.") from None
        if int(self.pixels.triangle.max(initial=LEFT_OUT)) >= len(self.room.triangles):
            text = "The pixels' checkpoint names triangles that the room lacks."
            raise FiptError("file-damaged", text, "Start the estimation again.")
        self.parts = self._choose_parts()

    def _choose_parts(self) -> Parts:
        bounds = zip(self.pixels.ranges[:-1], self.pixels.ranges[1:], strict=True)
        triangles = [np.asarray(self.pixels.triangle[first:last]) for first, last in bounds]
        return choose_parts(self.room, self.views, triangles)

    def _open_shadings(self, create: bool = False, keep: bool = False) -> ShadingStore:
        folder = self.folder.stage / self._shadings
        return open_shadings(folder, len(self.pixels), len(self.levels), create, keep)

    def _load_shadings(self, name: str) -> None:
        """Check the shadings that a finished stage wrote, unless a later one wrote over them.

        Raises:
            FiptError: ``file-damaged``.
        """
        if self.checkpoints.holds_shadings(name):
            self._open_shadings()

    @cached_property
    def _pieces(self) -> np.ndarray | None:
        """(T,) int32 connected piece of each triangle; None where parts are known, which need no pieces."""
        return None if self.parts.kind == "part" else room_pieces(self.room)

    # Hints

    def _use_hints(self, told: Sequence[Hint]) -> None:
        """Honour these hints from here on, instead of those before."""
        self._input = None
        self.hints, self.observations = None, self._observed
        if not told:
            return
        room, parts = self.room, self.parts
        self.hints = hints = place_hints(told, room.vertices, room.triangles, parts, self._pieces)
        left_alone = hints.of_triangles(hints.left_alone)
        self.observations = replace(
            self._observed,
            parts=hints.split_parts(parts),
            left_alone=left_alone if left_alone.any() else None,
        )

    def _material_units(self, data: TrainingData) -> Units:
        """The units of a closed-form estimate."""
        units = self._units_before  # the network knows them by these numbers
        if units is None or self._pieces is None:
            units = material_units(self._pieces, data, self.room.scan is not None)
        if self.hints is None:
            return units
        return hinted_units(units, self.observations.parts, self.hints, data.materials)

    # Closed form and network

    def _save_estimate(self, name: str) -> None:
        """Keep what the closed-form estimate of this name has found."""
        fixed = self.units.fixed
        arrays = {
            "probability": self.probability,
            "diffuse": self.diffuse,
            "materials": self.materials,
            "unit": self.units.triangle,
            "single": self.units.single,
            "fixed": np.zeros((0, 2), np.float32) if fixed is None else fixed,
        }
        tensors = {key: torch.from_numpy(array) for key, array in arrays.items()}
        self.checkpoints.save_tensors(name, tensors)

    def _load_estimate(self, name: str) -> None:
        """Read back the closed-form estimate of this name.

        Raises:
            FiptError: ``file-damaged``.
        """
        state = self.checkpoints.load_tensors(name, torch.device("cpu"))
        try:
            arrays = {key: state[key].numpy() for key in _ESTIMATE_ARRAYS}
            check_layouts(
                arrays | {"room": self.room.triangles}, _ESTIMATE_ARRAYS | {"room": ("i", ("T", 3))}
            )
        except (KeyError, AttributeError, TypeError, ValueError) as error:
            raise _unreadable(name, error) from None
        self.diffuse, self.materials = arrays["diffuse"], arrays["materials"]
        self.probability = arrays["probability"]
        fixed = arrays["fixed"] if len(arrays["fixed"]) else None
        self._find_cells(Units(arrays["unit"], arrays["single"], fixed))

    def _new_network(self, hash_levels: int, typical: np.ndarray) -> BrdfNetwork:
        return BrdfNetwork(self.settings, hash_levels, typical, network_generator(self.settings), self.device)

    def _new_mask(self) -> EmissionNetwork:
        return EmissionNetwork(network_generator(self.settings), self.device)

    def _save_networks(self, name: str, networks: Networks) -> None:
        """Keep what the training of this name has found."""
        self.checkpoints.save_tensors(name, networks.state())

    def _load_networks(self, name: str) -> None:
        """Read back the materials that the training of this name has found.

        Raises:
            FiptError: ``file-damaged``.
        """
        state = self.checkpoints.load_tensors(name, self.device)
        try:
            levels = state["brdf"]["mlp.0.weight"].shape[1] // self.settings.hash_features
            self.brdf = self._new_network(levels, np.zeros((len(self.units.single) + 1, 5)))
            self.brdf.load_state_dict(state["brdf"])
        except (KeyError, AttributeError, IndexError, TypeError, ValueError, RuntimeError) as error:
            raise _unreadable(name, error) from None

    def _find_cells(self, units: Units) -> None:
        """Take the units of the last estimate, and find where pixels saw them; known parts never change."""
        if not np.array_equal(units.triangle, self.units.triangle):
            self.cells = find_seen_cells(self.pixels, units, self.box)
        self.units = units

    # The estimate

    def _presumed_lamps(self) -> tuple[EmitterTable, np.ndarray]:
        """What stage 1 aims at, and (T,) bool, the lamps that it presumes; see :mod:`..light.presumed`."""
        pixels = self.pixels
        bright = bright_triangles(self.room, pixels.triangle, pixels.front, pixels.radiance)
        if self.settings.presumed_lamps:
            return presume_lamps(self.room, EmitterPixels.of(pixels), bright)
        in_cache = np.ones(len(bright.triangles), bool)
        return replace(bright, reflective=in_cache), np.zeros(len(self.room.triangles), bool)

    def _group_fixtures(self) -> None:
        """Fixtures of the triangles that probably emit."""
        parts = self.observations.parts
        surface = parts.triangle_part if parts.kind == "part" else None
        pixels = EmitterPixels.of(self.pixels)
        self.fixtures = group_fixtures(self.room, self.probability > 0.5, pixels, surface, self.probability)

    def _emitters(self) -> tuple[EmitterTable, np.ndarray]:
        """The fixtures as a table of triangles, and the triangles that emit, (T,) bool."""
        table = emitter_table(self.fixtures)
        emitting = np.zeros(len(self.room.triangles), bool)
        emitting[table.triangles] = True
        return table, emitting

    def _fields(self) -> Fields:
        return Fields(self.brdf, self.box)

    @cached_property
    def _emitter_surfaces(self) -> EmitterSurfaces:
        """What emits as a whole."""
        environment = self.observations.environment
        inferred = None if environment is None else environment.unseen
        return emitter_surfaces(self.room, self.parts, self.observations.footprint, inferred)

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cache entries with a surface point each; see :meth:`Observations.places`."""
        return self.observations.places(self.room, np.random.default_rng([self.settings.seed, 4]))

    def _entry_values(self, cells: CellEstimate) -> np.ndarray:
        """(M * 6, 5) base colour, roughness and metallic of each cache entry.

        Entries without a cell take the median of their unit, or the value of the nearest cell.
        """
        entries, points, triangles = self._places
        known, values, seen_triangle = cells.by_entry()
        place = place_of(known, entries)
        has_cell = place >= 0
        result = np.full((len(entries), 5), 0.5, np.float32)
        if has_cell.any():
            result[has_cell] = values[place[has_cell]]
            unit = np.append(self.units.triangle, NO_PART)
            seen_unit = unit[seen_triangle[place[has_cell]]]
            units = len(self.units.single)
            statistics = seen_statistics(points[has_cell], seen_unit, result[has_cell], units)
            missing = ~has_cell
            result[missing] = fallback_values(points[missing], unit[triangles[missing]], statistics)
        return pool(self.observations.grid, entries, result)[0]

    def _network_colors(self, rows: np.ndarray) -> np.ndarray:
        """(R, 3) base colour that the network has for the pixels `rows` (R,)."""
        unit = np.append(self.units.triangle, NO_PART)[np.asarray(self.pixels.triangle[rows])]
        return self._fields().query(np.asarray(self.pixels.position[rows]), unit)[:, :3]

    # What is reported of it

    def _progress_within(self, begin: float, end: float) -> Callable[[float], None]:
        """Progress of a piece of work that takes the stage from the share `begin` to `end`."""
        return lambda done: self.reporter.progress(begin + (end - begin) * done)

    def _warn_of_damage(self, text: str) -> None:
        self.reporter.warning(
            "checkpoint-damaged", f"{text} The stages that need it are done again.", "There is nothing to do."
        )

    def summary(self) -> dict[str, Any]:
        """The statistics of the run: times and rays of the stages, memory, counts, settings."""
        return {
            "stages": self.checkpoints.facts(),
            "peak_memory_gb": round(peak_memory_gb(), 3),
            "pixels": len(self.pixels),
            "light_resolution": self.plan.resolution,
            "expected": self.plan.cost,
            "triangles": len(self.room.triangles),
            "fixtures": len(self.fixtures),
            "part_kind": self.parts.kind,
            "radiance_scale": self.scale,
            "variant": mi.variant(),
            "views": self.view_check.facts() | {"used": len(self.views) - len(self.view_check.left_out)},
            "settings": asdict(self.settings),
            **({"photometry": self.photometry} if self.photometry else {}),
            **(_hole_facts(self.holes) if self.holes else {}),
            **({"hints": hint_facts(self.hints, self.units)} if self.hints else {}),
        }

    def files(self) -> list[Path]:
        """The results in open formats that exist."""
        folder = self.folder
        results = [folder.fields_npz, folder.parts_json, folder.emitters_json]
        results += [folder.environment_exr, folder.statistics_json]
        return [path for path in results if path.exists()]


def _hole_facts(holes: ScanHoles) -> dict[str, Any]:
    return {
        "closed_holes": holes.closed,
        "closed_holes_m2": round(holes.closed_area, 4),
        "open_holes": holes.left,
        "open_holes_m2": round(holes.open_area, 4),
    }


def _unreadable(name: str, error: Exception) -> FiptError:
    return FiptError(
        "file-damaged", f"The checkpoint {name} can't be read ({error}).", "Start the estimation again."
    )
