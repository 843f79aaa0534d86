# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages that trace rays: the photographs' pixels, stage 1 and stage 3 (paper Sec. 4.2 and 4.3)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ..checks.view_check import check_views
from ..light.baking import Baking, ShadingStore, TracedLight, bake_views, baked_light
from ..light.observations import observe
from ..light.shadings import SampleCounts
from ..light.unseen_light import with_unseen_light
from ..optics.lights import EmitterTable
from ..photometry.encoded_photographs import Photometry, adjust_photographs, warn_of_photographs
from ..photometry.refit import refit_photographs
from ..pixels.fragments import SUBPIXELS
from ..pixels.grouped import numbered
from ..pixels.mixed_pixels import mark_pure
from ..pixels.store import fill_pixels, open_pixels
from ..pixels.unmixing import keep_pure, unmix_pixels
from ..run.checkpoints import HINTED_REFINEMENT, HINTED_SHADINGS
from ..run.errors import FiptError
from ..run.finished_views import FinishedViews
from .state import EstimationState, Facts


class LightStages(EstimationState):
    """Pixels and shadings of an estimation; arguments as of :class:`EstimationState`."""

    # ---- Pixels: first hits, parts, pure and mixed pixels (supplementary), and a check of the views --------

    def _trace(self) -> Facts:
        self.pixels = open_pixels(self.folder.stage / "pixels", self.views, create=True)
        self.scale = fill_pixels(self.pixels, self.room, self._progress_within(0.0, 0.4), self.workers)
        self._sort_pixels(0.4, 0.7)
        shown = self.scale
        found = self._adjust_photographs()
        self.view_check = check_views(
            self.pixels, self.room, self.parts.triangle_part, self.settings, self.reporter, self.far_off
        )
        if self.view_check.left_out:  # their masks no longer count
            self._sort_pixels(0.7, 0.8)
        self._unmix(found, self._progress_within(0.8, 0.85 if found else 1.0))
        if found:
            self._readjust_photographs(found)
            self.photometry["median_shown"] = shown
        self.checkpoints.remember("scale", self.scale)
        self.checkpoints.remember("photometry", self.photometry)
        self.checkpoints.remember("view_check", self.view_check.facts())
        rows = (self.pixels.rows(index) for index in range(len(self.views)))
        pure = sum(int(np.count_nonzero(self.pixels.pure[view])) for view in rows)
        return {"rays": 6 * len(self.pixels) + len(SUBPIXELS) * (len(self.pixels) - pure)}

    def _unmix(self, found: Photometry | None, progress: Callable[[float], None]) -> None:
        """Find the pixels' own radiance and its weight."""
        if self.settings.unmix:
            unmix_pixels(self.pixels, self.room, self._surface_labels(), progress, self.workers)
        else:
            keep_pure(self.pixels)
        if found is None:
            return
        for index in range(len(self.views)):
            rows = self.pixels.rows(index)
            self.pixels.weight[rows] *= found.weight[rows]

    def _adjust_photographs(self) -> Photometry | None:
        """Turn photographs that are not HDR into radiance; None where all are HDR."""
        if not any(view.encoded for view in self.views):
            return None
        part, folder = self._surface_labels(), self.folder.stage / "pixels"
        return adjust_photographs(self.pixels, self.room, part, self.scale, self.settings, folder)

    def _readjust_photographs(self, found: Photometry) -> None:
        """Find their response and the clipped lamps again, with the light of shadings of stage 1."""
        if self.settings.refit_photographs:
            self._prepare()
            baking = self._baking(*self._first_light(), None, 0)
            part, light_of = self._surface_labels(), partial(baked_light, baking, self.pixels)
            found = refit_photographs(found, self.pixels, self.room, part, light_of)
            self._unmix(found, self._progress_within(0.85, 1.0))
        self.scale, self.photometry = found.scale, found.facts
        warn_of_photographs(found.facts, self.reporter)

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
        if self.settings.unseen_light:
            label = self._surface_labels()
            self._observed = with_unseen_light(self._observed, self.room, label, self.settings)
        self._use_hints(self.told)

    # ---- Stage 1: shadings from the radiance cache (Sec. 4.2, Eq. 9) ---------------------------------------

    def _bake(self) -> Facts:
        return self._bake_views("shadings", *self._first_light(), None, 0)

    def _first_light(self) -> tuple[np.ndarray, EmitterTable, SampleCounts]:
        """Cache, presumed lamps and numbers of samples of stage 1."""
        settings = self.settings
        table, lamps = self._presumed_lamps()
        counts = SampleCounts(settings.diffuse_spp, settings.specular_spp, settings.light_spp)
        return self.observations.cache(without=lamps), table, counts

    def _baking(
        self,
        cache: np.ndarray | None,
        emitters: EmitterTable,
        counts: SampleCounts,
        traced: TracedLight | None,
        index: int,
    ) -> Baking:
        """The baking of round `index`; other arguments as of :class:`Baking`."""
        environment, settings = self.observations.environment, self.settings
        return Baking(
            room=self.room,
            labels=self.parts.triangle_part,
            grid=self.observations.grid,
            cache=cache,
            traced=traced,
            emitters=emitters,
            environment=environment,
            levels=self.levels,
            counts=counts,
            denoise=settings.denoise,
            denoise_specular=settings.denoise_specular,
            masking=settings.masking,
            seed=settings.seed * 31 + 1 + index,
        )

    def _bake_views(
        self,
        name: str,
        cache: np.ndarray | None,
        emitters: EmitterTable,
        counts: SampleCounts,
        traced: TracedLight | None,
        index: int,
    ) -> Facts:
        """Bake the shadings of all views in the stage of this name; other arguments as of `_baking`."""
        baking = self._baking(cache, emitters, counts, traced, index)
        finished = self.checkpoints.finished_views(name)
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

    # ---- Stage 3: shadings by path tracing (Sec. 4.3, Eq. 10 and 11) ---------------------------------------

    def _refine(self, name: str, index: int) -> Facts:
        settings = self.settings
        self._input = None  # its files are written over
        table, emitting = self._emitters()
        cache = self.observations.cache(without=emitting) if settings.refine_cache else None
        diffuse = self.diffuse if settings.refine_cache else None
        traced = TracedLight(self.materials, diffuse, settings.cache_roughness, settings.refine_depth)
        counts = SampleCounts(
            settings.refine_diffuse_spp, settings.refine_specular_spp, settings.refine_light_spp
        )
        return self._bake_views(name, cache, table, counts, traced, index)

    def _refine_again(self) -> Facts:
        """Repeat the last refinement with the lamps and materials of the hints, beside its shadings."""
        self._shadings = HINTED_SHADINGS
        return self._refine(HINTED_REFINEMENT, max(self.settings.rounds, 1))

    def _load_shadings_again(self) -> None:
        """Use the shadings of `_refine_again`.

        Raises:
            FiptError: ``file-damaged``.
        """
        self._shadings = HINTED_SHADINGS
        self._open_shadings()
