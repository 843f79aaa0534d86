# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages that fit materials: closed form, emitters and stage 2 (paper Sec. 4.4 and 4.5); the results."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..light.emission import emission_probability
from ..light.evidence import brighter_than_white
from ..light.lamp_doubt import HardlySeen, hardly_seen, light_errors, power_errors
from ..material.cell_errors import DrawnPixels, add_light_errors, cell_errors, draw_pixels, lit_cells
from ..material.closed_form import (
    CellEstimate,
    TrainingData,
    fit_cells,
    followed_by_paths,
    white_rows,
)
from ..material.fields import RoomFields
from ..material.hints import SurfaceHints
from ..material.inference import Fields
from ..material.networks import typical_values, useful_hash_levels
from ..material.part_colors import room_detail
from ..material.training import (
    PRETRAINING_STEPS,
    Networks,
    Resume,
    Surfaces,
    pretrain,
    read_checkpoint,
    train,
)
from ..material.training_input import training_input
from ..report.fixture_names import fixture_names
from ..run.checkpoints import HINTED_ESTIMATE, HINTED_LAMPS, HINTED_TRAINING, UNFINISHED, DamagedStage
from ..run.errors import FiptError
from ..run.replacing import keep_inputs
from ..run.runfolder import RunFolder, write_json
from ..run.versions import new_results, note_version, prune
from ..textures.detail import remember_views, write_resolution
from .doubts import write_doubts
from .hinted import area_names, write_left_alone
from .part_list import write_part_list
from .results import RoomLight, write_results
from .state import EstimationState, Facts

# The last steps of the training that are repeated with hints, as a share of all: high learning rates would
# unlearn what the hints say nothing of.
AGAIN_SHARE = 1.0 / 3.0
# Share of the pixels that are brighter than white surfaces above which light is missing: rooms have 0.01 to
# 0.09, the example room with its lamps painted out 0.3 to 0.4.
MISSING_LIGHT = 0.25


class MaterialStages(EstimationState):
    """Materials and emitters of an estimation; arguments as of :class:`EstimationState`."""

    # ---- Closed form (Eq. 5) and emitters (Sec. 4.4) -------------------------------------------------------

    def _estimate(self, name: str, refined: bool) -> Facts:
        """The estimate of this name; `refined`: whether shadings are refined with it afterwards."""
        self._input = None  # that of the round before
        data, cells = self._closed_form()
        if name == "estimate-0":
            self._warn_of_missing_light()
        self._find_cells(self._material_units(data))
        self.probability = self._emission_probability(data, self._told_emission())
        if self.hints is not None:
            self._warn_of_hints(name, self.hints, self.probability > 0.5)
        self._group_fixtures()
        self.diffuse, self.materials = np.zeros((0, 3), np.float16), np.zeros((0, 5), np.float32)
        if refined:
            # Kept for stage 3, which writes over the shadings from which these are made.
            self.diffuse = self.observations.means(data.shadings.diffuse).astype(np.float16)
            limit = self.settings.cache_roughness
            self.materials = self._entry_values(followed_by_paths(cells, data.materials.error[:, 0], limit))
        self._save_estimate(name)
        return {"cells": len(cells.keys)}

    def _warn_of_missing_light(self) -> None:
        """Say where the light that photographs show can't be what lights the room."""
        share = brighter_than_white(self.pixels, self._open_shadings())
        if share > MISSING_LIGHT:
            self.reporter.warning(
                "light-missing",
                f"{100.0 * share:.0f} % of the pixels are brighter than white surfaces would be in the light"
                " that the photographs show: lamps or windows are missing in them, and false ones will be"
                " found.",
                "Add photographs that show the lamps, and use them as the camera made them: not painted over,"
                " not cropped, not tone-mapped.",
            )

    def _warn_of_hints(self, name: str, hints: SurfaceHints, emitting: np.ndarray) -> None:
        """Say which hints could not be honoured, and whether the shadings are those of other lamps."""
        if hints.problems and name in ("estimate-0", HINTED_LAMPS, HINTED_ESTIMATE):
            text = "Some hints could not be honoured: " + " ".join(hints.problems)
            self.reporter.warning("hints-unclear", text, "Correct or remove these hints.")
        if (
            name == HINTED_ESTIMATE
            and (self._emitters()[1] != emitting)[hints.of_triangles(hints.emits) != 0].any()
        ):
            self.reporter.warning(
                "hints-lamps",
                "The hints change which surfaces are lamps, but the light in the room is that of before.",
                "Tick Light Changes Too and estimate again with hints, or use Estimate.",
            )

    def _closed_form(self) -> tuple[TrainingData, CellEstimate]:
        """The data to train on with the last shadings, and the closed-form estimate of all cells."""
        if self._input is None:
            shadings, settings = self._open_shadings(), self.settings
            given = self.observations, self._pieces, shadings, self.levels, settings
            data = training_input(*given, self.hints)
            self._input = (data, fit_cells(data))
        return self._input

    def _told_emission(self) -> np.ndarray:
        """(T,) int8, 1 on triangles that emit by hints, -1 on those that do not or are left alone, else 0."""
        hints = self.hints
        if hints is None:
            return np.zeros(len(self.room.triangles), np.int8)
        told = hints.emits - (hints.left_alone & (hints.emits == 0))
        return np.asarray(hints.of_triangles(told), np.int8)

    def _emission_probability(self, data: TrainingData, told: np.ndarray) -> np.ndarray:
        """(T,) probability that each triangle emits; `told`: :meth:`_told_emission`."""
        room, pixels = self.room, self.pixels
        baked = (self._emitters() if self.fixtures else self._presumed_lamps())[1]
        shadings, surfaces = self._open_shadings(), self._emitter_surfaces
        white, hdr = partial(white_rows, data), not self.photometry
        return emission_probability(room, pixels, shadings, white, surfaces, told, baked, hdr)

    def _closed_form_colors(self, rows: np.ndarray) -> np.ndarray:
        """(R, 3) base colour of the last closed-form estimate in the pixels `rows` (R,)."""
        if len(self.materials):
            return self.materials[self.observations.entry[rows], :3]
        data, cells = self._closed_form()
        place = cells.of_pixels(data, rows)
        return np.where(place[:, None] >= 0, cells.color[place], np.float32(0.5))

    def _resume_estimate(self, name: str) -> None:
        # Emitters are read, not found anew: the shadings they were found with may have been refined since.
        self._load_estimate(name)
        self._group_fixtures()

    # ---- Stage 2: BRDF and emission mask (Sec. 4.5, Eq. 12, 14 to 20); emitters (Sec. 4.4, Eq. 13) ---------

    def _train(self) -> Facts:
        """Fit the networks to the closed-form estimate, then to the photographs; find the emitters."""
        data, cells = self._closed_form()
        surfaces = self._surfaces()
        networks = self._new_networks(cells)
        checkpoint = self.folder.stage / f"{UNFINISHED}.pt"
        state = None
        if checkpoint.exists():
            try:
                state = read_checkpoint(checkpoint, networks, self.settings.training_steps)
            except FiptError as error:
                self._warn_of_damage(error.text)
                checkpoint.unlink()
        fitted = PRETRAINING_STEPS / (PRETRAINING_STEPS + self.settings.training_steps)
        if state is None:
            progress = self._progress_within(0.0, fitted)
            pretrain(networks.brdf, data, surfaces, cells, self.settings, progress)
        progress = self._progress_within(fitted, 1.0)
        train(networks, data, surfaces, self.settings, Resume(checkpoint, state), progress)
        facts = self._keep_training("training", networks, self.settings.training_steps)
        checkpoint.unlink(missing_ok=True)
        return facts

    def _train_again(self) -> Facts:
        """Continue from the networks that were trained without these hints.

        The networks add detail to the typical values of the units, those of the new closed form. The
        training's last steps are repeated.
        """
        data, cells = self._closed_form()
        networks = self._new_networks(cells)
        try:
            state = self.checkpoints.load_tensors("training", self.device)
            state["brdf"]["typical"] = networks.brdf.state_dict()["typical"]
            networks.load(state)
        except (FiptError, KeyError, TypeError, RuntimeError) as error:
            raise DamagedStage("training", f"The checkpoint training can't be read ({error}).") from error
        steps = max(round(AGAIN_SHARE * self.settings.training_steps), 1)
        first = self.settings.training_steps - steps
        train(networks, data, self._surfaces(), self.settings, None, self.reporter.progress, first)
        return self._keep_training(HINTED_TRAINING, networks, steps)

    def _surfaces(self) -> Surfaces:
        """What is known of the surfaces before a training."""
        _, emitting = self._emitters()
        return Surfaces(self.box, self.units.triangle, emitting)

    def _new_networks(self, cells: CellEstimate) -> Networks:
        """Networks that are not trained yet, with the typical values of the units."""
        unit = self.units.triangle[cells.triangle]
        hash_levels = useful_hash_levels(self.settings, self.box.extent, self.observations.footprint)
        typical = typical_values(cells.values, unit, len(self.units.single))
        self.brdf = self._new_network(hash_levels, typical)
        return Networks(self.brdf, self._new_mask())

    def _keep_training(self, name: str, networks: Networks, steps: int) -> Facts:
        """Keep trained networks."""
        self._save_networks(name, networks)
        return {"steps": steps, "hash_levels": len(networks.brdf.grid.resolutions)}

    # ---- Results -------------------------------------------------------------------------------------------

    def _write_results(self) -> None:
        _, emitting = self._emitters()
        left_alone = self.observations.left_alone
        fields = self._room_fields(emitting if left_alone is None else emitting | left_alone)
        light = RoomLight(self.fixtures, self.observations.environment, self.view_check.lamps)
        areas = area_names(self.hints, self.units)
        with new_results(self.folder) as folder:
            write_results(folder, fields, light, self.scale, self.reporter)
            names = write_part_list(folder, self.room, self.parts, self.views, self.pixels, fields, areas)
            write_left_alone(folder, left_alone)
            self._write_doubts(folder, np.array([*names, ""], object)[fields.units.triangle])
            remember_views(folder, self.views, self._shadings)
            write_resolution(folder, len(self.room.triangles))
            write_json(folder.statistics_json, self.summary())
            keep_inputs(folder, folder.results)
            note_version(folder.results)
        prune(self.folder, self.settings.kept_versions)

    def _room_fields(self, unused: np.ndarray) -> RoomFields:
        """The estimate on all surfaces, from the pixels of all triangles but `unused` (T,)."""
        data, fields, units, cells = self._closed_form()[0], self._fields(), self.units, self.cells
        drawn = draw_pixels(self.pixels, units, self.box, cells, unused, self.settings.seed)
        errors = self._cell_errors(data, fields, drawn)
        detail = None
        if self.settings.shrink_detail:
            detail = room_detail(drawn, data, units, fields, cells, errors)
        return RoomFields(fields, units, cells, errors, self.room.place, detail)

    def _cell_errors(self, data: TrainingData, fields: Fields, drawn: DrawnPixels) -> np.ndarray:
        """(C, 3) standard errors in the seen cells."""
        seed = self.settings.seed
        errors = cell_errors(drawn, data, self.units, fields, self.cells)
        if not self.settings.lamp_doubt:
            return errors
        doubted = hardly_seen(self.fixtures, self.pixels, len(self.room.triangles))
        place = self.room.place
        if not self.fixtures or not (place or doubted):
            return errors
        lit = lit_cells(drawn, data, fields, self.cells)
        if doubted:
            self._warn_of_lamps(doubted)
            of_power = power_errors(self.room, self.fixtures, doubted, (lit.points, lit.normals), seed)
            errors = add_light_errors(errors, lit, of_power)
        if not place:
            return errors
        of_light = light_errors(self.room, self.fixtures, (lit.points, lit.normals), place, seed)
        return add_light_errors(errors, lit, of_light)

    def _warn_of_lamps(self, doubted: Sequence[HardlySeen]) -> None:
        """Say which lamps photographs hardly show."""
        names = fixture_names(self.room, self.fixtures)
        listed = ", ".join(f"{names[lamp.index]} ({lamp.pixels} pixels)" for lamp in doubted)
        self.reporter.warning(
            "lamp-hardly-seen",
            f"The photographs hardly show these lamps: {listed}. Their light and the colors near them may be"
            " wrong: glow may have become paint.",
            "Add photographs that show these lamps from near, most of all their bright insides.",
        )

    def _write_doubts(self, folder: RunFolder, names: np.ndarray) -> None:
        data, cells = self._closed_form()
        decided = np.zeros((len(self.probability), 3), bool)
        if self.hints is not None:
            decided = self.hints.of_triangles(self.hints.decides)
        write_doubts(folder, data, cells, self.probability, decided, names)
