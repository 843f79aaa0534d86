# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages that trace rays: the photographs' pixels, stage 1 and stage 3 (paper Sec. 4.2 and 4.3)."""

from __future__ import annotations

import numpy as np

from ..light.baking import Baking, ShadingStore, TracedLight, bake_views
from ..light.emitters import EmitterPixels, bright_triangles
from ..light.observations import observe
from ..light.presumed import presume_lamps
from ..light.shadings import SampleCounts
from ..optics.lights import EmitterTable
from ..run.errors import FiptError
from ..run.finished_views import FinishedViews
from ..scene.disagreement import doubt_pixels
from ..scene.fragments import SUBPIXELS
from ..scene.grouped import numbered
from ..scene.mixed_pixels import mark_pure
from ..scene.pixels import fill_pixels, open_pixels
from ..scene.unmixing import unmix_pixels
from ..views.check import check_views
from ..views.photometry import adjust_photographs
from .state import EstimationState, Facts


class LightStages(EstimationState):
    """Pixels and shadings of an estimation; arguments as of :class:`EstimationState`."""

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
