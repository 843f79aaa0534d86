"""The stages that bake shadings: stage 1 from the cache (Sec. 4.2), stage 3 by path tracing (Sec. 4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..light.baking import Baking, ShadingStore, TracedLight, bake_views, open_shadings
from ..light.emitters import bright_triangles, presume_lamps
from ..light.environment import Environment
from ..light.observations import Observations, observe
from ..light.shadings import SampleCounts, roughness_levels
from ..light.unseen_light import with_unseen_light
from ..material.hints import known_colors
from ..optics.lights import EmitterTable
from ..parts.labels import Parts, surface_labels
from ..pixels.store import PixelStore
from ..run.chain import Tools
from ..run.errors import FiptError
from ..run.hints import Hint
from ..run.stage_settings import (
    LightSettings,
    RefinementSettings,
    ShadingSettings,
)
from ..surface.room import Room

# Share of the light that is inferred, and difference of the baked light from it, from which the user is told.
MUCH_INFERRED, MUCH_DIFFERENT = 0.1, 0.05


def observe_pixels(
    pixels: PixelStore, room: Room, parts: Parts, *, settings: LightSettings, tools: Tools
) -> Observations:
    """What follows from the pixels before any estimate: radiance cache, environment; without hints."""
    return observe(room, pixels, parts, settings, tools.folder)


@dataclass(frozen=True)
class PresumedLamps:
    """What stage 1 aims at (:func:`..light.emitters.presume_lamps`).

    Attributes:
        bright: triangles to sample, and their radiance; that of presumed lamps is not in the cache.
        presumed: (T,) bool, these lamps.
    """

    bright: EmitterTable
    presumed: np.ndarray


def find_presumed_lamps(pixels: PixelStore, room: Room, *, settings: ShadingSettings) -> PresumedLamps:
    """Presume which bright surfaces are lamps, before any light is known."""
    bright = bright_triangles(room, pixels)
    if settings.presumed_lamps:
        return PresumedLamps(*presume_lamps(room, pixels, bright))
    in_cache = np.ones(len(bright.triangles), bool)
    return PresumedLamps(replace(bright, reflective=in_cache), np.zeros(len(room.triangles), bool))


def infer_outside(
    observed: Observations,
    lamps: PresumedLamps,
    room: Room,
    parts: Parts,
    references: Sequence[Hint],
    *,
    settings: LightSettings,
    tools: Tools,
) -> Environment | None:
    """What the pixels see outside, with light from unseen directions where the mesh is open; None without.

    Args:
        observed: of a room that may be open. lamps: the presumed ones.
        references: the hints that know a base colour.
    """
    if settings.unseen_light:
        label, bright = surface_labels(room, parts), lamps.bright.not_reflective()
        known = known_colors(references, room.vertices, room.triangles, parts, label)
        observed = with_unseen_light(observed, room, label, bright, settings, known)
    light = observed.environment
    if light is not None and light.unseen_light > MUCH_INFERRED:
        tools.reporter.warning(
            "light-inferred", unseen_light=100.0 * light.unseen_light, unseen_error=100.0 * light.unseen_error
        )
    return light


def light_outside(observed: Observations, environment: Environment | None) -> Observations:
    """The observations with the light from outside."""
    return replace(observed, environment=environment)


# ---- Stage 1: shadings from the radiance cache (Sec. 4.2, Eq. 9) -------------------------------------------


def bake_shadings(
    observed: Observations,
    lamps: PresumedLamps,
    pixels: PixelStore,
    room: Room,
    parts: Parts,
    *,
    settings: ShadingSettings,
    tools: Tools,
) -> ShadingStore:
    """Bake the shadings of all views from the radiance cache; `lamps` are the presumed ones."""
    baking = first_baking(room, parts, observed, lamps, settings)
    store = _bake(baking, pixels, tools)
    tools.facts["light_excess"] = excess = light_excess(observed.environment, store.diffuse)
    if abs(excess) > MUCH_DIFFERENT:
        tools.reporter.warning("light-differs", excess=100.0 * excess)
    return store


def light_excess(environment: Environment | None, diffuse: np.ndarray) -> float:
    """Median share by which the baked L_d of all pixels (N, 3) exceeds the light that was inferred.

    0 without inferred light. A difference shows that the shadings have other light than was solved for.
    """
    if environment is None or environment.pixels is None or environment.light is None:
        return 0.0
    compared = diffuse[environment.pixels], environment.light
    baked, inferred = (np.asarray(array, np.float64).mean(axis=1) for array in compared)
    known = (baked > 0.0) & (inferred > 0.0)
    return float(np.expm1(np.median(np.log(baked[known] / inferred[known])))) if known.any() else 0.0


def first_baking(
    room: Room, parts: Parts, observations: Observations, lamps: PresumedLamps, settings: ShadingSettings
) -> Baking:
    """The baking of stage 1."""
    counts = SampleCounts(settings.diffuse_spp, settings.specular_spp, settings.light_spp)
    cache = observations.cache(without=lamps.presumed)
    return _baking(room, parts, observations, cache, lamps.bright, counts, None, settings, 0)


def _baking(
    room: Room,
    parts: Parts,
    observations: Observations,
    cache: np.ndarray | None,
    emitters: EmitterTable,
    counts: SampleCounts,
    traced: TracedLight | None,
    settings: ShadingSettings | RefinementSettings,
    index: int,
) -> Baking:
    """The baking of round `index`; other arguments as of :class:`Baking`."""
    spread = settings.roughness_levels, settings.roughness_min, settings.roughness_spacing
    return Baking(
        room=room,
        labels=parts.triangle_part,
        grid=observations.grid,
        cache=cache,
        traced=traced,
        emitters=emitters,
        environment=observations.environment,
        levels=roughness_levels(*spread),
        counts=counts,
        denoise=settings.denoise,
        denoise_specular=settings.denoise_specular,
        masking=settings.masking,
        seed=settings.seed * 31 + 1 + index,
    )


def _bake(baking: Baking, pixels: PixelStore, tools: Tools) -> ShadingStore:
    """The shadings of all views; those that an interrupted run has finished are kept."""
    finished, size = tools.finished, (len(pixels), baking.levels)
    store = None
    if finished.views:
        try:
            store = open_shadings(tools.folder, *size, create=True, keep=True)
        except FiptError:
            finished.forget()
    store = store or open_shadings(tools.folder, *size, create=True)
    finished.flush = store.flush
    tools.facts["rays"] = bake_views(store, pixels, baking, tools.reporter.progress, tools.workers, finished)
    return store


# ---- Stage 3: shadings by path tracing (Sec. 4.3, Eq. 10 and 11) -------------------------------------------


def refine_shadings(
    index: int,
    observed: Observations,
    pixels: PixelStore,
    room: Room,
    parts: Parts,
    emitters: EmitterTable,
    emitting: np.ndarray,
    diffuse: np.ndarray,
    materials: np.ndarray,
    *,
    settings: RefinementSettings,
    tools: Tools,
) -> ShadingStore:
    """Bake the shadings of all views anew by path tracing with the estimate.

    Args:
        index: number of the round.
        emitters: the fixtures found so far, and emitting: (T,) bool, their triangles.
        diffuse: (M * 6, 3) float16 mean L_d of each cache entry in the last closed-form estimate.
        materials: (M * 6, 5) float32 base colour, roughness and metallic of each entry in it.
    """
    cache = observed.cache(without=emitting) if settings.refine_cache else None
    light = diffuse if settings.refine_cache else None
    traced = TracedLight(materials, light, settings.cache_roughness, settings.refine_depth)
    counts = SampleCounts(
        settings.refine_diffuse_spp, settings.refine_specular_spp, settings.refine_light_spp
    )
    baking = _baking(room, parts, observed, cache, emitters, counts, traced, settings, index)
    return _bake(baking, pixels, tools)
