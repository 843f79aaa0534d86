# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of one estimation: its input, what its stages have computed so far, and how that is read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from ..capture.views import View, load_capture
from ..device.variant import torch_device
from ..light.baking import ShadingStore, open_shadings
from ..light.cache import pool
from ..light.emitters import Fixture, emitter_table
from ..light.observations import Observations
from ..light.shadings import roughness_levels
from ..material.fields import RoomFields
from ..material.groups import Units
from ..material.inference import Fields, mask_at
from ..material.networks import BrdfNetwork, EmissionNetwork
from ..material.seen import SeenCells, find_seen_cells, room_box
from ..optics.lights import EmitterTable
from ..run.arrays import check_layouts
from ..run.checkpoints import Checkpoints, stage_keys
from ..run.errors import FiptError
from ..run.messages import Reporter, peak_memory_gb
from ..run.per_view import LocalWorkers, Workers
from ..run.runfolder import RunFolder
from ..run.settings import Settings
from ..run.shapes import Layout
from ..scene.labels import Parts, choose_parts, room_pieces
from ..scene.pixels import LEFT_OUT, PixelStore, open_pixels
from ..scene.room import load_room
from ..views.check import ViewCheck

# What a training's checkpoint holds besides the networks; see `EstimationState._save_training`.
_TRAINING_ARRAYS: dict[str, Layout] = {
    "emitting": ("b", ("T",)),
    "diffuse": ("f", ("M", 3)),
    "unit": ("i", ("T",)),
    "single": ("b", ("U",)),
}


def spread_views(views: Sequence[View], share: float) -> list[View]:
    """A share of the views (0 to 1, one at least), spread evenly over their order."""
    count = max(1, round(share * len(views)))
    return [views[i * len(views) // count] for i in range(count)]


class EstimationState:
    """Input and intermediate results of one estimation on a run folder.

    Args:
        folder: holds capture.json and room.npz.
        settings: of the run.
        reporter: gets stages, progress and warnings.
        workers: who does the work that each view needs for itself; None: this process.

    Attributes:
        pixels: all pixels of the training views, with the surface points that they see.
        scale: median radiance of the photographs; all radiance below is in this unit.
        view_check: views that were left out or corrected.
        parts: of the room's triangles.
        observations: what the pixels tell before anything is estimated: cache, environment.
        brdf, emission: the networks of stage 2.
        units, cells: surfaces of one material, and where pixels saw them.
        fixtures: the emitters found so far.
        diffuse: (M * 6, 3) float16 mean L_d of each cache entry after the last training.

    Raises:
        FiptError: ``views-none``, or where the capture or the room can't be read.
    """

    def __init__(
        self, folder: RunFolder, settings: Settings, reporter: Reporter, workers: Workers | None = None
    ) -> None:
        self.folder, self.settings, self.reporter = folder, settings, reporter
        self.workers = workers or LocalWorkers()
        self.device = torch.device(torch_device())
        self.capture = load_capture(folder)
        self.room = load_room(folder)
        if not self.capture.train:
            raise FiptError("views-none", "The capture has no training views.", "Add photographs.")
        self.views = spread_views(self.capture.train, settings.view_share)
        self.levels = roughness_levels(
            settings.roughness_levels, settings.roughness_min, settings.roughness_spacing
        )
        self.box = room_box(self.room.bounds)
        files = [folder.capture_json, folder.room_npz, folder.room_json]
        images = [path for view in self.views for path in view.files]
        self.checkpoints = Checkpoints(folder.stage, stage_keys(settings, files, images))
        self.pixels: PixelStore
        self.scale = 1.0
        self.view_check = ViewCheck()
        self.parts: Parts
        self.observations: Observations
        self.hash_levels: int
        self.brdf: BrdfNetwork
        self.emission: EmissionNetwork
        self.units = Units(np.zeros(0, np.int32), np.zeros(0, bool))
        self.cells: SeenCells
        self.fixtures: list[Fixture] = []
        self.diffuse: np.ndarray

    # Pixels and shadings

    def _load_pixels(self) -> None:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views)
        self.scale = float(self.checkpoints.recall("scale"))
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
        folder = self.folder.stage / "shadings"
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

    # Trainings

    def _save_training(self, index: int, emitting: np.ndarray) -> None:
        """Keep what training number `index` has found, with the triangles that emit ((T,) bool)."""
        self.checkpoints.save_tensors(
            f"networks-{index}",
            {
                "brdf": self.brdf.state_dict(),
                "emission": self.emission.state_dict(),
                "emitting": torch.from_numpy(emitting),
                "diffuse": torch.from_numpy(self.diffuse),
                "unit": torch.from_numpy(self.units.triangle),
                "single": torch.from_numpy(self.units.single),
            },
        )

    def _load_training(self, index: int) -> np.ndarray:
        """Read back what training number `index` has found; returns the triangles that emit, (T,) bool.

        Raises:
            FiptError: ``file-damaged``.
        """
        name = f"networks-{index}"
        state = self.checkpoints.load_tensors(name, self.device)
        try:
            arrays = {key: state[key].cpu().numpy() for key in _TRAINING_ARRAYS}
            check_layouts(
                arrays | {"room": self.room.triangles}, _TRAINING_ARRAYS | {"room": ("i", ("T", 3))}
            )
            self.brdf.load_state_dict(state["brdf"])
            self.emission.load_state_dict(state["emission"])
        except (KeyError, AttributeError, TypeError, ValueError, RuntimeError) as error:
            text = f"The checkpoint {name} can't be read ({error})."
            raise FiptError("file-damaged", text, "Start the estimation again.") from None
        self.diffuse = arrays["diffuse"]
        self._find_cells(Units(arrays["unit"], arrays["single"]))
        return arrays["emitting"]

    def _find_cells(self, units: Units) -> None:
        """Take the units of the last training, and find where pixels saw them; known parts never change."""
        if not np.array_equal(units.triangle, self.units.triangle):
            self.cells = find_seen_cells(self.pixels, units, self.box)
        self.units = units

    # The estimate

    def _mask(self, positions: np.ndarray) -> np.ndarray:
        """Emission mask alpha at world positions (N, 3)."""
        return mask_at(self.emission, self.box, positions)

    def _emitters(self) -> tuple[EmitterTable, np.ndarray]:
        """The fixtures as a table of triangles, and the triangles that emit, (T,) bool."""
        table = emitter_table(self.fixtures)
        emitting = np.zeros(len(self.room.triangles), bool)
        emitting[table.triangles] = True
        return table, emitting

    def _fields(self) -> Fields:
        return Fields(self.brdf, self.box)

    def _room_fields(self, errors: np.ndarray | None = None) -> RoomFields:
        """The estimate on all surfaces; with `errors` (:func:`cell_errors`) shrunk towards its units."""
        return RoomFields(self._fields(), self.units, self.cells, errors)

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cache entries with a surface point each; see :meth:`Observations.places`."""
        return self.observations.places(self.room, np.random.default_rng([self.settings.seed, 4]))

    def _material_values(self) -> np.ndarray:
        """(M * 6, 5) base colour, roughness and metallic of each cache entry."""
        entries, points, triangles = self._places
        fields, seen = self._room_fields(), triangles < 0
        values = np.empty((len(entries), 5), np.float32)
        values[seen] = np.column_stack(fields.fields.query(points[seen]))
        values[~seen] = np.column_stack(fields.query(points[~seen], triangles[~seen]))
        return pool(self.observations.grid, entries, values)[0]

    # What is reported of it

    def summary(self) -> dict[str, Any]:
        """The statistics of the run: times and rays of the stages, memory, counts, settings."""
        return {
            "stages": self.checkpoints.facts(),
            "peak_memory_gb": round(peak_memory_gb(), 3),
            "pixels": len(self.pixels),
            "triangles": len(self.room.triangles),
            "fixtures": len(self.fixtures),
            "part_kind": self.parts.kind,
            "radiance_scale": self.scale,
            "variant": mi.variant(),
            "views": self.view_check.facts() | {"used": len(self.views) - len(self.view_check.left_out)},
            "settings": asdict(self.settings),
        }

    def files(self) -> list[Path]:
        """The results in open formats that exist."""
        folder = self.folder
        results = [folder.fields_npz, folder.emitters_json, folder.environment_exr, folder.statistics_json]
        return [path for path in results if path.exists()]
