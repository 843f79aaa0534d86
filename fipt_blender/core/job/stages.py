# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages of one estimation, each with a checkpoint: what a killed run has done is not done again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from ..capture.views import View, load_capture
from ..device.variant import torch_device
from ..light.cache import pool
from ..light.emitters import Fixture, bright_triangles, emitter_table
from ..light.observations import Observations, observe
from ..light.reflecting import separate
from ..light.shadings import SampleCounts, roughness_levels
from ..light.views import Baking, ShadingStore, TracedLight, bake_views, open_shadings
from ..material.fields import Fields, RoomFields, mask_at, new_networks_generator, render_pixels
from ..material.groups import Units
from ..material.networks import BrdfNetwork, EmissionNetwork, useful_hash_levels
from ..material.seen import SeenCells, room_box
from ..material.training import PRETRAINING_STEPS, pretrain, train
from ..render.lights import EmitterTable
from ..scene.labels import Parts, choose_parts, room_pieces
from ..scene.pixels import PixelStore, fill_pixels, mark_pure, open_pixels
from ..scene.room import load_room
from .certainty import cell_errors, find_cells, lamp_pixels
from .checkpoints import Checkpoints, stage_keys, stage_names
from .errors import FiptError
from .lamps import find_lamps, make_fixtures
from .messages import Reporter, peak_memory_gb
from .per_view import LocalWorkers, Workers
from .previews import Preview
from .results import write_results
from .runfolder import RunFolder, explained_write_errors, write_json
from .settings import Settings
from .training_input import material_units, training_input
from .view_check import ViewCheck, check_views

# Expected seconds of each stage in proportion, for the progress bar only.
_WEIGHTS = {"pixels": 0.1, "shadings": 1.0, "training": 1.6, "refinement": 1.2}


def spread_views(views: Sequence[View], share: float) -> list[View]:
    """A share of the views (0 to 1, one at least), spread evenly over their order."""
    count = max(1, round(share * len(views)))
    return [views[i * len(views) // count] for i in range(count)]


class Estimation:
    """One estimation on a run folder.

    Args:
        folder: holds capture.json and room.npz.
        settings: of the run.
        reporter: gets stages, progress and warnings.
        workers: who does what each view needs for itself; this process where none are given.
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
        images = [path for v in self.views for path in v.files]
        self.checkpoints = Checkpoints(folder.stage, stage_keys(settings, files, images))
        self.pixels: PixelStore
        self.view_check = ViewCheck()
        self.parts: Parts
        self.seen: Observations
        self.scale = 1.0
        self.fixtures: list[Fixture] = []
        self.diffuse: np.ndarray
        self.units = Units(np.zeros(0, np.int32), np.zeros(0, bool))
        self.cells: SeenCells
        self.brdf: BrdfNetwork
        self.emission: EmissionNetwork

    def run(self) -> None:
        """All stages that are not done yet."""
        rounds = self.settings.rounds
        names = stage_names(rounds)
        steps = [self.settings.training_steps] + [self.settings.later_training_steps] * rounds
        weights = []
        for name in names:
            kind, _, number = name.partition("-")
            share = steps[int(number)] / max(steps[0], 1) if kind == "training" else 1.0
            weights.append(_WEIGHTS[kind] * share)
        self.reporter.plan(weights)
        with explained_write_errors(self.folder.stage):
            self._stage(names[0], "Tracing the photographs' pixels", self._trace, self._load_pixels)
            self._prepare()
            self._stage(names[1], "Stage 1: baking shadings from the photographs", self._bake, lambda: None)
            self._show(names[1])
            for index in range(rounds + 1):
                if index:
                    self._stage(
                        f"refinement-{index}",
                        f"Stage 3: refining shadings (round {index} of {rounds})",
                        partial(self._refine, index),
                        lambda: None,
                    )
                self._stage(
                    f"training-{index}",
                    f"Stage 2: training materials (round {index} of {rounds})",
                    partial(self._train, index, steps[index]),
                    partial(self._load_training, index),
                )
                self._show(f"training-{index}")
            self._write_results()

    def _stage(
        self,
        name: str,
        text: str,
        work: Callable[[], dict[str, Any] | None],
        load: Callable[[], None],
    ) -> None:
        """Do one stage, or load its results where a checkpoint says that it is done."""
        if self.checkpoints.done(name):
            load()
            self.reporter.skip()
            return
        self.checkpoints.begin(name)
        self.reporter.stage(name, text)
        started = time.monotonic()
        facts = work() or {}
        facts["seconds"] = round(time.monotonic() - started, 2)
        if facts.get("rays"):
            facts["mrays_per_second"] = round(facts["rays"] / facts["seconds"] / 1e6, 3)
        self.checkpoints.mark(name, facts)

    def _show(self, name: str) -> None:
        """Let the window show what a stage has found."""
        preview = Preview(self.folder.stage / "previews", self.pixels, self.room.triangle_object)
        paths = preview.made(name)
        if not paths and name == "shadings":
            paths = preview.first_guess(name, self._open_shadings())
        elif not paths:
            paths = preview.estimate(name, Fields(self.brdf, self.box), emitter_table(self.fixtures))
        self.reporter.progress(
            1.0, force=True, pictures=[path.relative_to(self.folder.root).as_posix() for path in paths]
        )

    # Pixels

    def _trace(self) -> dict[str, Any]:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views, create=True)
        self.scale = fill_pixels(
            self.pixels, self.room, lambda done: self.reporter.progress(0.4 * done), self.workers
        )
        self._sort_pixels(0.4, 0.8)
        self.view_check = check_views(
            self.pixels, self.room, self.parts.triangle_part, self.settings, self.reporter
        )
        if self.view_check.left_out:  # their masks no longer count
            self._sort_pixels(0.8, 1.0)
        self.checkpoints.remember("scale", self.scale)
        self.checkpoints.remember("view_check", self.view_check.facts())
        return {"rays": 6 * len(self.pixels)}

    def _sort_pixels(self, begin: float, end: float) -> None:
        """Parts of the triangles, and which pixels see one thing alone."""
        self.parts = self._choose_parts()
        mark_pure(
            self.pixels,
            self.room,
            self.parts.triangle_part,
            lambda done: self.reporter.progress(begin + (end - begin) * done),
            self.workers,
        )

    def _load_pixels(self) -> None:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views)
        self.scale = float(self.checkpoints.recall("scale"))
        self.view_check = ViewCheck(**self.checkpoints.recall("view_check"))
        self.parts = self._choose_parts()

    def _choose_parts(self) -> Parts:
        bounds = zip(self.pixels.ranges[:-1], self.pixels.ranges[1:], strict=True)
        triangles = [np.asarray(self.pixels.triangle[first:last]) for first, last in bounds]
        return choose_parts(self.room, self.views, triangles)

    def _prepare(self) -> None:
        """Everything that follows from the pixels and is quick to make again."""
        self.seen = observe(self.room, self.pixels, self.parts, self.settings, self.folder.stage / "observed")
        generator = new_networks_generator(self.settings)
        self.hash_levels = useful_hash_levels(self.settings, self.box.extent, self.seen.footprint)
        self.brdf = BrdfNetwork(self.settings, self.hash_levels, generator, self.device)
        self.emission = EmissionNetwork(self.settings, generator, self.device)

    # Stage 1

    def _bake(self) -> dict[str, Any]:
        settings = self.settings
        store = self._open_shadings(create=True)
        guide = bright_triangles(self.room, self.pixels.triangle, self.pixels.front, self.pixels.radiance)
        counts = SampleCounts(settings.diffuse_spp, settings.specular_spp, settings.light_spp)
        return self._bake_views(store, self.seen.cache(), None, guide, counts, 0)

    def _bake_views(
        self,
        store: ShadingStore,
        cache: np.ndarray | None,
        traced: TracedLight | None,
        emitters: EmitterTable,
        counts: SampleCounts,
        index: int,
    ) -> dict[str, Any]:
        """Bake all views; the arguments are those of :class:`Baking`, and the index of the round."""
        environment, settings = self.seen.environment, self.settings
        baking = Baking(
            self.room,
            self.parts.triangle_part,
            self.seen.grid,
            cache,
            traced,
            emitters,
            None if environment is None else environment.image,
            self.levels,
            counts,
            settings.denoise,
            settings.denoise_specular,
            settings.masking,
            settings.seed * 31 + 1 + index,
        )
        return {"rays": bake_views(store, self.pixels, baking, self.reporter.progress, self.workers)}

    def _open_shadings(self, create: bool = False) -> ShadingStore:
        return open_shadings(self.folder.stage / "shadings", len(self.pixels), len(self.levels), create)

    # Stage 2

    @cached_property
    def _pieces(self) -> np.ndarray | None:
        """(T,) int32 connected piece of each triangle; None where parts are known and nobody asks."""
        return None if self.parts.kind == "part" else room_pieces(self.room)

    def _train(self, index: int, steps: int) -> dict[str, Any]:
        data, guess, rows = training_input(
            self.pixels,
            self.seen,
            self.parts,
            self._pieces,
            self._open_shadings(),
            self.levels,
            self.box.normalise,
            self.settings.seed,
        )
        checkpoint = self.folder.stage / f"training-{index}.pt"
        before = PRETRAINING_STEPS / (PRETRAINING_STEPS + steps)
        if not checkpoint.exists():
            pretrain(
                self.brdf,
                self.emission if index == 0 else None,
                data,
                guess,
                rows,
                self.settings,
                index,
                self.device,
                lambda done: self.reporter.progress(before * done),
            )
        train(
            self.brdf,
            self.emission,
            data,
            self.settings,
            steps,
            index,
            self.device,
            checkpoint,
            lambda done: self.reporter.progress(before + (1.0 - before) * done),
        )
        self._find_cells(material_units(self.pixels, self.parts, self._pieces, data))
        # Semantic classes, and parts that no pixel saw, have no guess.
        part = self.parts.triangle_part
        guessed = (part >= 0) & (part < len(guess.part_emits))
        constant = np.zeros(len(part), bool)
        constant[guessed] = guess.part_emits[part[guessed]]
        joint = self.settings.emission == "joint"
        emitting = constant if joint else self._find_emitters(index, constant)
        self._group_fixtures(emitting, index)
        # Kept, as the next stage writes over the shadings that it is made of.
        self.diffuse = self.seen.means(self._open_shadings().diffuse).astype(np.float16)
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
        checkpoint.unlink(missing_ok=True)
        return {"steps": steps, "hash_levels": self.hash_levels}

    def _load_training(self, index: int) -> None:
        state = self.checkpoints.load_tensors(f"networks-{index}", self.device)
        self.brdf.load_state_dict(state["brdf"])
        self.emission.load_state_dict(state["emission"])
        self.diffuse = state["diffuse"].cpu().numpy()
        self._find_cells(Units(state["unit"].cpu().numpy(), state["single"].cpu().numpy()))
        # Not found anew: the shadings that it took may have been refined since, or half refined.
        self._group_fixtures(state["emitting"].cpu().numpy(), index)

    def _mask(self, positions: np.ndarray) -> np.ndarray:
        return mask_at(self.emission, self.box, positions)

    def _find_emitters(self, index: int, constant: np.ndarray) -> np.ndarray:
        """(T,) bool, triangles that emit; those of `constant` ((T,) bool) do in any case."""
        shadings = self._open_shadings()
        fields = self.brdf, self.box, self.pixels.position
        estimate = partial(render_pixels, *fields, shadings.diffuse, shadings.specular, self.levels)
        return find_lamps(
            self.room, self.pixels, shadings, self._mask, estimate, constant, self.settings, index
        )

    def _group_fixtures(self, emitting: np.ndarray, index: int) -> None:
        self.fixtures = make_fixtures(self.room, self.pixels, emitting, self._mask, self.settings, index)

    # Stage 3

    def _refine(self, index: int) -> dict[str, Any]:
        settings = self.settings
        table = emitter_table(self.fixtures)
        emitting = np.zeros(len(self.room.triangles), bool)
        emitting[table.triangles] = True
        # What was fitted jointly is read from the cache like all else: its rim counts nothing twice.
        lamps = emitting if settings.emission == "mask" else None
        cache = self.seen.cache(without=lamps) if settings.refine_cache else None
        diffuse = self.diffuse if settings.refine_cache else None
        traced = TracedLight(
            self._material_values(), diffuse, settings.cache_roughness, settings.refine_depth
        )
        counts = SampleCounts(
            settings.refine_diffuse_spp, settings.refine_specular_spp, settings.refine_light_spp
        )
        return self._bake_views(self._open_shadings(create=True), cache, traced, table, counts, index)

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.seen.places(self.room, np.random.default_rng([self.settings.seed, 4]))

    def _material_values(self) -> np.ndarray:
        """(M * 6, 5) base colour, roughness and metallic of each cache entry."""
        entries, points, triangles = self._places
        fields, seen = self._room_fields(), triangles < 0
        values = np.empty((len(entries), 5), np.float32)
        values[seen] = np.column_stack(fields.fields.query(points[seen]))
        values[~seen] = np.column_stack(fields.query(points[~seen], triangles[~seen]))
        return pool(self.seen.grid, entries, values)[0]

    # Results

    def _find_cells(self, units: Units) -> None:
        """Take the units that the last training found, and where pixels saw them; known parts stay."""
        if not np.array_equal(units.triangle, self.units.triangle):
            self.cells = find_cells(self.pixels, units, self.box)
        self.units = units

    def _room_fields(self, errors: np.ndarray | None = None) -> RoomFields:
        """The estimate on all surfaces; with `errors` (:func:`cell_errors`) drawn to what units say."""
        return RoomFields(Fields(self.brdf, self.box), self.units, self.cells, errors)

    def _write_results(self) -> None:
        emitting = np.zeros(len(self.room.triangles), bool)
        emitting[emitter_table(self.fixtures).triangles] = True
        shadings = self._open_shadings()
        errors = cell_errors(
            self.pixels,
            self.units,
            shadings,
            self.levels,
            Fields(self.brdf, self.box),
            self.cells,
            emitting,
            self.settings.seed,
        )
        fixtures = self.fixtures, np.zeros((len(self.fixtures), 3))
        if self.settings.emission != "joint":
            pixels = lamp_pixels(self.pixels, shadings, emitting, self.settings.seed)
            fixtures = separate(self.fixtures, pixels)
        fields = self._room_fields(errors)
        write_results(self.folder, fields, *fixtures, self.seen.environment, self.scale, self.reporter)
        write_json(self.folder.statistics_json, self.summary())

    def summary(self) -> dict[str, Any]:
        """Stage times, rays and memory."""
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
        """The results in open formats."""
        folder = self.folder
        wanted = [folder.fields_npz, folder.emitters_json, folder.environment_exr, folder.statistics_json]
        return [path for path in wanted if path.exists()]
