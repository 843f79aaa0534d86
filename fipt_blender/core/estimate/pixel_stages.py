"""The stages before any light: what pixels see, the radiance of photographs, and the check of the views.

Radiance is in units of the capture's median from the first stage on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..capture.views import View
from ..checks.view_check import ViewCheck, check_views
from ..light.baking import baked_light
from ..light.observations import observe
from ..light.unseen_light import with_unseen_light
from ..parts.labels import Parts, choose_parts, surface_labels
from ..photometry.encoded_photographs import Photometry, adjust_photographs, warn_of_photographs
from ..photometry.refit import refit_photographs
from ..pixels.fragments import SUBPIXELS
from ..pixels.mixed_pixels import mark_pure
from ..pixels.store import PixelStore, create_pixels, fill_pixels
from ..pixels.unmixing import keep_pure, unmix_pixels
from ..run.chain import Tools
from ..run.stage_settings import (
    CheckSettings,
    PhotometrySettings,
    RefitSettings,
    UnmixSettings,
)
from ..surface.room import Room
from .light_stages import find_presumed_lamps, first_baking

_RAYS_TO_TRACE, _RAYS_TO_MARK = 1, 5  # a pixel, for the statistics


@dataclass(frozen=True)
class TracedPixels:
    """First hits.

    Attributes:
        pixels: all pixels; pure ones are marked, the radiance of mixed ones is not divided yet.
        parts: of the room's triangles.
        scale: median radiance of the photographs, in their unit.
    """

    pixels: PixelStore
    parts: Parts
    scale: float


def trace_pixels(views: list[View], room: Room, *, tools: Tools) -> TracedPixels:
    """Intersect the photographs' pixels with the mesh, and choose the parts of its triangles."""
    pixels = create_pixels(tools.folder, views)
    scale = fill_pixels(pixels, room, tools.progress_within(0.0, 0.6), tools.workers)
    parts = parts_of(room, pixels)
    mark_pure(pixels, room, parts.triangle_part, tools.progress_within(0.6, 1.0), tools.workers)
    tools.facts["rays"] = (_RAYS_TO_TRACE + _RAYS_TO_MARK) * len(pixels)
    return TracedPixels(pixels, parts, scale)


def parts_of(room: Room, pixels: PixelStore) -> Parts:
    """The parts of a room's triangles by what the pixels see."""
    triangles = [np.asarray(pixels.triangle[pixels.rows(index)]) for index in range(len(pixels.views))]
    return choose_parts(room, pixels.views, triangles)


@dataclass(frozen=True)
class AdjustedPhotographs:
    """Radiance of photographs that are not HDR; fields as of :class:`TracedPixels`."""

    pixels: PixelStore
    photometry: Photometry
    scale: float


def find_photometry(
    pixels: PixelStore, room: Room, parts: Parts, scale: float, *, settings: PhotometrySettings, tools: Tools
) -> AdjustedPhotographs:
    """Turn photographs that are not HDR, and decoded by sRGB's curve, into radiance."""
    pixels = pixels.with_copies(tools.folder, "radiance")
    found = adjust_photographs(pixels, room, surface_labels(room, parts), scale, settings, tools.folder)
    return AdjustedPhotographs(pixels, found, found.scale)


@dataclass(frozen=True)
class CheckedPixels:
    """Pixels without those of misaligned views, and with radiance of one exposure."""

    pixels: PixelStore
    parts: Parts
    view_check: ViewCheck


def check_poses(
    pixels: PixelStore,
    room: Room,
    parts: Parts,
    far_off: dict[int, float],
    *,
    settings: CheckSettings,
    tools: Tools,
) -> CheckedPixels:
    """Leave out misaligned views, bring the others to one exposure, leave out lamps that the mesh lacks.

    Args:
        far_off: views whose poses are far off, and their correlation with the others.
    """
    pixels = pixels.with_copies(tools.folder, "radiance", "triangle", "pure")
    check = check_views(pixels, room, parts.triangle_part, settings, tools.reporter, far_off)
    if check.left_out:  # their masks no longer count
        parts = parts_of(room, pixels)
        mark_pure(pixels, room, parts.triangle_part, tools.progress_within(0.5, 1.0), tools.workers)
    return CheckedPixels(pixels, parts, check)


def divide_mixed_pixels(
    pixels: PixelStore,
    room: Room,
    parts: Parts,
    photometry: Photometry | None = None,
    *,
    settings: UnmixSettings,
    tools: Tools,
) -> PixelStore:
    """The pixels with the radiance of the surface at the centre of each, and its weight."""
    pixels = pixels.with_copies(tools.folder, "own", "weight")
    _unmix(pixels, room, surface_labels(room, parts), photometry, settings, tools.reporter.progress, tools)
    rows = (pixels.rows(index) for index in range(len(pixels.views)))
    pure = sum(int(np.count_nonzero(pixels.pure[view])) for view in rows)
    tools.facts["rays"] = len(SUBPIXELS) * (len(pixels) - pure)
    return pixels


def _unmix(
    pixels: PixelStore,
    room: Room,
    labels: np.ndarray,
    photometry: Photometry | None,
    settings: UnmixSettings,
    progress: Callable[[float], None],
    tools: Tools,
) -> None:
    if settings.unmix:
        unmix_pixels(pixels, room, labels, progress, tools.workers)
    else:
        keep_pure(pixels)
    if photometry is not None:
        for index in range(len(pixels.views)):
            rows = pixels.rows(index)
            pixels.weight[rows] *= photometry.weight[rows]


def refit_photometry(
    pixels: PixelStore,
    room: Room,
    parts: Parts,
    photometry: Photometry,
    *,
    settings: RefitSettings,
    tools: Tools,
) -> AdjustedPhotographs:
    """Find the response and the clipped lamps again, with the light of shadings of stage 1."""
    found = photometry
    if settings.refit_photographs:
        labels = surface_labels(room, parts)
        pixels = pixels.with_copies(tools.folder, "radiance", "own", "weight")
        lamps = find_presumed_lamps(pixels, room, settings=settings)
        observations = observe(room, pixels, parts, settings, tools.folder)
        if settings.unseen_light:
            outside = lamps.bright.not_reflective()
            observations = with_unseen_light(observations, room, labels, outside, settings)
        baking = first_baking(room, parts, observations, lamps, settings)
        found = replace(found, found=found.found.of_pixels(pixels))
        found = refit_photographs(found, pixels, room, labels, partial(baked_light, baking, pixels))
        progress = tools.progress_within(0.5, 1.0)
        _unmix(pixels, room, labels, found, settings, progress, tools)
    warn_of_photographs(found.facts, tools.reporter)
    return AdjustedPhotographs(pixels, found, found.scale)
