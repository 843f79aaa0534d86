# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's algorithm (Sec. 4) as a sequence of stages, each with a checkpoint.

    pixels          intersect the photographs' pixels with the mesh; check the views
    shadings        stage 1: bake the shadings from the radiance cache (Sec. 4.2, Eq. 9)
    estimate-0      closed-form estimate of the BRDF (Eq. 5); find the emitters (Sec. 4.4)
    refinement-i    stage 3: bake the shadings anew by path tracing (Sec. 4.3, Eq. 10 and 11)
    estimate-i      closed form and emitters with the refined shadings
    training        stage 2: fit BRDF and emission mask, once, and find the emitters (Sec. 4.5, Eq. 12 to 20)
    hinted-estimate, hinted-training
                    closed form and a short training again, with hints that were given since

Stage 3 and the closed form are repeated `rounds` times. A run that is resumed loads the stages that it has
finished. The computations are in `light/`, `views/` and `material/`, the data that stages share in
:mod:`.state`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..light.baking import Baking, ShadingStore, TracedLight, bake_views
from ..light.emitters import EmitterPixels, bright_triangles
from ..light.evidence import find_emission
from ..light.observations import observe
from ..light.presumed import presume_lamps
from ..light.reflecting import separate
from ..light.shadings import SampleCounts
from ..material.cell_errors import cell_errors
from ..material.closed_form import MARKED_SHARE, CellEstimate, fit_cells, render_rows, triangle_emission
from ..material.emission_mask import EmissionNetwork, mask_at, masked_triangles
from ..material.hints import SurfaceHints
from ..material.networks import typical_values, useful_hash_levels
from ..material.pixel_samples import lamp_pixels
from ..material.projection import InitialEstimate
from ..material.training import (
    PRETRAINING_STEPS,
    Networks,
    Resume,
    Surfaces,
    TrainingData,
    pretrain,
    read_checkpoint,
    train,
)
from ..material.training_input import training_input
from ..optics.lights import EmitterTable
from ..run.checkpoints import HINTED_ESTIMATE, HINTED_TRAINING, UNFINISHED, DamagedStage, stage_names
from ..run.errors import FiptError
from ..run.finished_views import FinishedViews
from ..run.hints import Hint
from ..run.runfolder import explained_write_errors, write_json
from ..run.settings import Settings
from ..scene.disagreement import doubt_pixels
from ..scene.fragments import SUBPIXELS
from ..scene.grouped import numbered
from ..scene.mixed_pixels import mark_pure
from ..scene.pixels import fill_pixels, open_pixels
from ..scene.unmixing import unmix_pixels
from ..views.check import check_views
from ..views.photometry import adjust_photographs
from .doubts import write_doubts
from .hinted import write_left_alone
from .part_list import write_part_list
from .previews import Preview
from .results import RoomLight, write_results
from .state import EstimationState

Facts = dict[str, Any]  # what stages.json keeps of a stage; JSON-serialisable

# Expected time of each kind of stage relative to stage 1, for the progress bar only.
_WEIGHTS = {
    "pixels": 0.1,
    "shadings": 1.0,
    "estimate": 0.4,
    "refinement": 1.2,
    "training": 1.2,
    "hinted": 0.4,
}
# Steps of a training that continues with hints, as a share of the first one's.
AGAIN_SHARE = 1.0 / 3.0


class Estimation(EstimationState):
    """One estimation on a run folder; arguments as of :class:`EstimationState`."""

    def run(self) -> None:
        """Do all stages that are not finished yet, and write the results.

        A finished stage whose files are damaged is discarded with a warning, and done again.
        """
        if self.checkpoints.problem:
            self._warn_of_damage(self.checkpoints.problem)
        finished = False
        while not finished:
            try:
                self._do_stages()
                finished = True
            except DamagedStage as damage:
                self._warn_of_damage(str(damage))
                self.checkpoints.discard(damage.stage)

    def _warn_of_damage(self, text: str) -> None:
        self.reporter.warning(
            "checkpoint-damaged", f"{text} The stages that need it are done again.", "There is nothing to do."
        )

    def _do_stages(self) -> None:
        rounds = self.settings.rounds
        self.reporter.plan(_stage_weights(self.settings, self.told_again is not None))
        with explained_write_errors(self.folder.stage):
            self._stage("pixels", "Tracing the photographs' pixels", self._trace, self._load_pixels)
            self._prepare()
            self._stage(
                "shadings",
                "Stage 1: baking shadings from the photographs",
                self._bake,
                partial(self._load_shadings, "shadings"),
            )
            self._show("shadings")
            for index in range(rounds + 1):
                if index:
                    self._stage(
                        f"refinement-{index}",
                        f"Stage 3: refining shadings (round {index + 1} of {rounds + 1})",
                        partial(self._refine, index),
                        partial(self._load_shadings, f"refinement-{index}"),
                    )
                self._stage(
                    f"estimate-{index}",
                    f"Estimating materials and lamps (round {index + 1} of {rounds + 1})",
                    partial(self._estimate, f"estimate-{index}"),
                    partial(self._resume_estimate, f"estimate-{index}"),
                )
                self._show(f"estimate-{index}")
            load = partial(self._load_networks, "training")
            self._stage("training", "Stage 2: training materials", self._train, load)
            self._show("training")
            if self.told_again is not None:
                self._estimate_again(self.told_again)
            self._write_results()

    def _stage(self, name: str, text: str, work: Callable[[], Facts], load: Callable[[], None]) -> None:
        """Do one stage, or load the results of a finished one and repeat its warnings.

        Raises:
            DamagedStage: its results can't be loaded.
        """
        if self.checkpoints.done(name):
            try:
                load()
            except FiptError as error:
                if error.code != "file-damaged":
                    raise
                raise DamagedStage(name, error.text) from error
            self.reporter.skip()
            for warning in self.checkpoints.warnings(name):
                if warning not in self.reporter.warnings:  # after damage all stages come by once more
                    self.reporter.warning(**warning)
            return
        self.checkpoints.begin(name)
        self.reporter.stage(name, text)
        started, warned = time.monotonic(), len(self.reporter.warnings)
        facts = work()
        seconds = time.monotonic() - started
        facts["seconds"] = round(seconds, 2)
        if facts.get("rays") and seconds > 0.0:
            facts["mrays_per_second"] = round(facts["rays"] / seconds / 1e6, 3)
        self.checkpoints.mark(name, facts, self.reporter.warnings[warned:])

    # ---- Pixels: first hits, parts, pure and mixed pixels (supplementary), and a check of the views --------

    def _trace(self) -> Facts:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views, create=True)
        self.scale = fill_pixels(self.pixels, self.room, self._progress_within(0.0, 0.4), self.workers)
        self._sort_pixels(0.4, 0.7)
        weight = self._adjust_photographs()
        self.view_check = check_views(
            self.pixels, self.room, self.parts.triangle_part, self.settings, self.reporter
        )
        if self.view_check.left_out:  # their masks no longer count
            self._sort_pixels(0.7, 0.8)
        unmix_pixels(
            self.pixels, self.room, self._surface_labels(), self._progress_within(0.8, 1.0), self.workers
        )
        doubt_pixels(self.pixels, self.room, self.parts)
        if weight is not None:
            self._weigh(weight)
        self.checkpoints.remember("scale", self.scale)
        self.checkpoints.remember("photometry", self.photometry)
        self.checkpoints.remember("view_check", self.view_check.facts())
        rows = (self.pixels.rows(index) for index in range(len(self.views)))
        pure = sum(int(np.count_nonzero(self.pixels.pure[view])) for view in rows)
        return {"rays": 6 * len(self.pixels) + len(SUBPIXELS) * (len(self.pixels) - pure)}

    def _weigh(self, weight: np.ndarray) -> None:
        """Multiply the weights of the pixels by `weight` (N,), view by view."""
        for index in range(len(self.views)):
            rows = self.pixels.rows(index)
            self.pixels.weight[rows] *= weight[rows]

    def _adjust_photographs(self) -> np.ndarray | None:
        """(N,) weights of the pixels' radiance where photographs are not HDR, which they are turned into."""
        if not any(view.encoded for view in self.views):
            return None
        part = self.parts.triangle_part
        found = adjust_photographs(self.pixels, self.room, part, self.scale, self.settings, self.reporter)
        self.scale, self.photometry = found.scale, found.facts
        return found.weight

    def _sort_pixels(self, begin: float, end: float) -> None:
        """Choose the parts of the triangles, and mark the pixels that see one surface of one part."""
        self.parts = self._choose_parts()
        progress = self._progress_within(begin, end)
        mark_pure(self.pixels, self.room, self.parts.triangle_part, progress, self.workers)

    def _surface_labels(self) -> np.ndarray:
        """(T,) int32 part of each triangle; where parts are unknown, label and connected piece."""
        part = self.parts.triangle_part
        if self._pieces is None:
            return part
        return numbered([part, self._pieces]).astype(np.int32)

    def _prepare(self) -> None:
        """Everything that follows from the pixels and is quick to make again."""
        self._observed = observe(
            self.room, self.pixels, self.parts, self.settings, self.folder.stage / "observed"
        )
        self._use_hints(self.told)

    # ---- Stage 1: shadings from the radiance cache (Sec. 4.2, Eq. 9) ---------------------------------------

    def _bake(self) -> Facts:
        settings = self.settings
        pixels = self.pixels
        bright = bright_triangles(self.room, pixels.triangle, pixels.front, pixels.radiance)
        table, lamps = presume_lamps(self.room, EmitterPixels.of(pixels), bright)
        counts = SampleCounts(settings.diffuse_spp, settings.specular_spp, settings.light_spp)
        return self._bake_views(self.observations.cache(without=lamps), None, table, counts, 0)

    def _bake_views(
        self,
        cache: np.ndarray | None,
        traced: TracedLight | None,
        emitters: EmitterTable,
        counts: SampleCounts,
        index: int,
    ) -> Facts:
        """Bake the shadings of all views in round `index`; other arguments as of :class:`Baking`."""
        environment, settings = self.observations.environment, self.settings
        baking = Baking(
            room=self.room,
            labels=self.parts.triangle_part,
            grid=self.observations.grid,
            cache=cache,
            traced=traced,
            emitters=emitters,
            environment=None if environment is None else environment.image,
            levels=self.levels,
            counts=counts,
            denoise=settings.denoise,
            denoise_specular=settings.denoise_specular,
            masking=settings.masking,
            seed=settings.seed * 31 + 1 + index,
        )
        finished = self.checkpoints.finished_views(f"refinement-{index}" if index else "shadings")
        store = self._shadings_to_bake(finished)
        progress = self.reporter.progress
        return {"rays": bake_views(store, self.pixels, baking, progress, self.workers, finished)}

    def _shadings_to_bake(self, finished: FinishedViews) -> ShadingStore:
        """New shadings, or those of an interrupted run with the views that it has finished."""
        store = None
        if finished.views:
            try:
                store = self._open_shadings(create=True, keep=True)
            except FiptError:
                finished.forget()
        store = store or self._open_shadings(create=True)
        finished.flush = store.flush
        return store

    # ---- Closed form (Eq. 5) and emitters (Sec. 4.4) -------------------------------------------------------

    def _estimate(self, name: str) -> Facts:
        self._input = None  # that of the round before
        data, initial, cells, bright = self._closed_form()
        joint = self.settings.emission == "joint"
        self._find_cells(self._material_units(data))
        known = self._known_emission(initial)
        if joint:
            emitting = known > 0
            self.emission = triangle_emission(cells, self.observations, data)
            self.emission[known < 0] = 0.0
        else:
            emitting = self._find_emitters(data, cells, bright > MARKED_SHARE, known)
        if self.hints is not None:
            self._warn_of_hints(name, self.hints, emitting)
        self._group_fixtures(emitting)
        # Kept for stage 3, which writes over the shadings from which these are made.
        self.diffuse = self.observations.means(data.diffuse).astype(np.float16)
        self.materials = self._entry_values(cells)
        self._save_estimate(name, emitting)
        return {"cells": len(cells.keys)}

    def _warn_of_hints(self, name: str, hints: SurfaceHints, emitting: np.ndarray) -> None:
        """Say which hints could not be honoured, and whether the shadings are those of other lamps."""
        if hints.problems and name in ("estimate-0", HINTED_ESTIMATE):
            text = "Some hints could not be honoured: " + " ".join(hints.problems)
            self.reporter.warning("hints-unclear", text, "Correct or remove these hints.")
        if (
            name == HINTED_ESTIMATE
            and (self._emitters()[1] != emitting)[hints.of_triangles(hints.emits) != 0].any()
        ):
            self.reporter.warning(
                "hints-lamps",
                "The hints change which surfaces are lamps, but the light in the room is that of before.",
                "Use Estimate: it computes the light anew with the hints.",
            )

    def _closed_form(self) -> tuple[TrainingData, InitialEstimate, CellEstimate, np.ndarray]:
        """The data to train on with the last shadings, the closed-form estimate of a sample of them, and
        that of all cells with the share of each triangle's pixels that are brighter than white (T,)."""
        if self._input is None:
            data, initial = training_input(
                self.observations,
                self._pieces,
                self._open_shadings(),
                self.levels,
                self.box.normalise,
                self.settings,
                self.hints,
            )
            joint = self.settings.lambda_joint if self.settings.emission == "joint" else None
            self._input = (data, initial, *fit_cells(self.observations, data, joint))
        return self._input

    def _known_emission(self, initial: InitialEstimate) -> np.ndarray:
        """(T,) int8, 1 on triangles that emit in any case, -1 on those that do not, 0 elsewhere.

        Parts emit whose radiance is constant although the light on them varies. Photographs that are not HDR
        show a constant radiance wherever they are clipped, on reflectors, too. Hints go before.
        """
        part = self.observations.parts.triangle_part
        known = np.zeros(len(part), np.int8)
        if not self.photometry:
            # Semantic classes, and parts that no pixel saw, have no estimate.
            has_part = (part >= 0) & (part < len(initial.part_emits))
            known[has_part] = initial.part_emits[part[has_part]]
        if self.hints is not None:
            told = self.hints.of_triangles(
                self.hints.emits - (self.hints.left_alone & (self.hints.emits == 0))
            )
            known = np.where(told != 0, told, known).astype(np.int8)
        return known

    def _find_emitters(
        self, data: TrainingData, cells: CellEstimate, marked: np.ndarray, known: np.ndarray
    ) -> np.ndarray:
        """(T,) bool, triangles that emit; `known`: :meth:`_known_emission`."""
        estimate = partial(render_rows, cells, self.observations, data)
        shadings, surfaces = self._open_shadings(), self._emitter_surfaces
        return find_emission(self.room, self.pixels, shadings, marked, known, estimate, surfaces)

    def _resume_estimate(self, name: str) -> None:
        # Emitters are read, not found anew: the shadings they were found with may have been refined since.
        self._group_fixtures(self._load_estimate(name))

    def _estimate_again(self, told: Sequence[Hint]) -> None:
        """Closed form and training again with these hints; pixels and shadings stay as they are."""
        self._units_before = self.units
        self._use_hints(told)
        self._stage(
            HINTED_ESTIMATE,
            "Estimating materials with the hints",
            partial(self._estimate, HINTED_ESTIMATE),
            partial(self._resume_estimate, HINTED_ESTIMATE),
        )
        load = partial(self._load_networks, HINTED_TRAINING)
        self._stage(HINTED_TRAINING, "Training materials with the hints", self._train_again, load)
        self._show(HINTED_TRAINING)

    # ---- Stage 2: BRDF and emission mask (Sec. 4.5, Eq. 12, 14 to 20); emitters (Sec. 4.4, Eq. 13) ---------

    def _train(self) -> Facts:
        """Fit the networks to the closed-form estimate, then to the photographs; find the emitters."""
        data, initial, _, _ = self._closed_form()
        surfaces = self._surfaces()
        networks = self._new_networks(initial)
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
            pretrain(networks, data, surfaces, initial, self.settings, progress)
        progress = self._progress_within(fitted, 1.0)
        train(networks, data, surfaces, self.settings, Resume(checkpoint, state), progress)
        facts = self._keep_training("training", networks, self.settings.training_steps)
        checkpoint.unlink(missing_ok=True)
        return facts

    def _train_again(self) -> Facts:
        """Continue from the networks that were trained without these hints.

        The networks add detail to the typical values of the units, which are those of the new closed form.
        """
        data, initial, _, _ = self._closed_form()
        networks = self._new_networks(initial)
        try:
            state = self.checkpoints.load_tensors("training", self.device)
            state["brdf"]["typical"] = networks.brdf.state_dict()["typical"]
            networks.load(state)
        except (FiptError, KeyError, TypeError, RuntimeError) as error:
            raise DamagedStage("training", f"The checkpoint training can't be read ({error}).") from error
        steps = max(round(AGAIN_SHARE * self.settings.training_steps), 1)
        shorter = replace(self.settings, training_steps=steps)
        train(networks, data, self._surfaces(), shorter, None, self.reporter.progress)
        return self._keep_training(HINTED_TRAINING, networks, steps)

    def _surfaces(self) -> Surfaces:
        """What is known of the surfaces before a training."""
        _, emitting = self._emitters()
        masked = np.zeros_like(emitting) if len(self.emission) else emitting
        return Surfaces(self.pixels.triangle, self.units.triangle, masked, self.emission)

    def _new_networks(self, initial: InitialEstimate) -> Networks:
        """Networks that are not trained yet, with the typical values of the units."""
        unit = self.units.triangle[self.pixels.triangle[initial.rows]]
        hash_levels = useful_hash_levels(self.settings, self.box.extent, self.observations.footprint)
        typical = typical_values(initial.values, unit, len(self.units.single))
        self.brdf = self._new_network(hash_levels, typical)
        return Networks(self.brdf, None if len(self.emission) else self._new_mask())

    def _keep_training(self, name: str, networks: Networks, steps: int) -> Facts:
        """Find the emitters by trained networks, and keep both."""
        _, emitting = self._emitters()
        if networks.emission is not None:
            emitting = self._masked_emitters(networks.emission)
            self._group_fixtures(emitting)
        self._save_networks(name, networks, emitting)
        return {"steps": steps, "hash_levels": len(networks.brdf.grid.resolutions)}

    def _masked_emitters(self, mask: EmissionNetwork) -> np.ndarray:
        """(T,) bool, triangles that emit, after the emission mask has been trained.

        Triangles emit that the mask or the closed form marks, and whose radiance reflection can't explain.
        """
        settings = self.settings
        data, initial, cells, bright = self._closed_form()
        marked = masked_triangles(
            self.room,
            partial(mask_at, mask, self.box),
            settings.emitter_threshold,
            settings.emitter_samples,
            np.random.default_rng([settings.seed, 3]),
            candidates=bright > 0.0,
        )
        marked |= bright > MARKED_SHARE
        return self._find_emitters(data, cells, marked, self._known_emission(initial))

    # ---- Stage 3: shadings by path tracing (Sec. 4.3, Eq. 10 and 11) ---------------------------------------

    def _refine(self, index: int) -> Facts:
        settings = self.settings
        self._input = None  # its files are written over
        table, emitting = self._emitters()
        # Emission that was fitted jointly is read from the cache: the rims of lamps then count only once.
        lamps = None if len(self.emission) else emitting
        cache = self.observations.cache(without=lamps) if settings.refine_cache else None
        diffuse = self.diffuse if settings.refine_cache else None
        traced = TracedLight(self.materials, diffuse, settings.cache_roughness, settings.refine_depth)
        counts = SampleCounts(
            settings.refine_diffuse_spp, settings.refine_specular_spp, settings.refine_light_spp
        )
        return self._bake_views(cache, traced, table, counts, index)

    # ---- Results -------------------------------------------------------------------------------------------

    def _write_results(self) -> None:
        _, emitting = self._emitters()
        shadings = self._open_shadings()
        left_alone = self.observations.left_alone
        errors = cell_errors(
            self.pixels,
            self.units,
            shadings,
            self._closed_form()[0],
            self._fields(),
            self.cells,
            emitting if left_alone is None else emitting | left_alone,
            self.settings.seed,
        )
        fixtures, colors = self.fixtures, np.zeros((len(self.fixtures), 3))
        if not len(self.emission):
            pixels = lamp_pixels(self.pixels, shadings, emitting, self.settings.seed)
            fixtures, colors = separate(self.fixtures, pixels)
        light = RoomLight(fixtures, colors, self.observations.environment, self.view_check.lamps)
        fields = self._room_fields(errors)
        write_results(self.folder, fields, light, self.scale, self.reporter)
        write_part_list(self.folder, self.room, self.parts, self.views, self.pixels, fields)
        write_left_alone(self.folder, left_alone)
        self._write_doubts()
        write_json(self.folder.statistics_json, self.summary())

    def _write_doubts(self) -> None:
        data, initial, _, bright = self._closed_form()
        decided = np.zeros(len(bright), bool)
        if self.hints is not None:
            decided = self.hints.of_triangles(self.hints.emits) != 0
        colors = _means(initial.base_color.mean(axis=1), data.group[initial.rows], len(data.group_errors))
        write_doubts(self.folder, self.pixels, data, bright, decided, colors)

    # ---- Progress ------------------------------------------------------------------------------------------

    def _progress_within(self, begin: float, end: float) -> Callable[[float], None]:
        """Progress of a piece of work that takes the stage from the share `begin` to `end`."""
        return lambda done: self.reporter.progress(begin + (end - begin) * done)

    def _show(self, name: str) -> None:
        """Send the window pictures of what a stage has found."""
        preview = Preview(self.folder.stage / "previews", self.pixels, self.room.triangle_object)
        paths = preview.existing(name)
        if not paths and name == "shadings":
            paths = preview.first_guess(name, self._open_shadings())
        elif not paths:
            colors = self._network_colors if name.endswith("training") else self._closed_form_colors
            paths = preview.estimate(name, colors, self._emitters()[0])
        relative = [path.relative_to(self.folder.root).as_posix() for path in paths]
        self.reporter.progress(1.0, force=True, pictures=relative)


def _stage_weights(settings: Settings, hinted: bool) -> list[float]:
    """Expected share of time of each stage, in no unit; for the progress bar."""
    return [_WEIGHTS[name.partition("-")[0]] for name in stage_names(settings.rounds, hinted)]


def _means(values: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(groups,) mean of values (N,) by group (N,), negative for none; 0 without any."""
    known = group >= 0
    count = np.bincount(group[known], minlength=groups)
    return np.bincount(group[known], values[known], minlength=groups) / np.maximum(count, 1)
