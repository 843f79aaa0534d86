# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles emit, from the evidence of single pixels (after the paper's Sec. 4.4 "Emitter extraction").

A pixel supports emission where its surface must emit because reflection can't explain its radiance. Light
that may come from another surface is no evidence: what spills over from neighbouring pixels, and what the
unmixed radiance of a mixed pixel may owe to its errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ..optics.factorised import DIELECTRIC_REFLECTANCE
from ..optics.lights import LUMINANCE
from ..scene.pixels import PixelStore
from ..scene.room import Room
from ..scene.unmixing import standard_error
from .baking import ShadingStore
from .emitter_surfaces import LEAST_RESIDUAL, EmitterSurfaces

# Share of a pure pixel's light that may spill over from its neighbours: half where coplanar surfaces meet at
# its centre, 16 to 30 % by a camera's blur (a Gaussian of half a pixel).
SPILL = 0.5
# Standard errors by which the unmixed radiance of a mixed pixel may be wrong.
DOUBT = 3.0
# Least relative residual of a mixed pixel: at bevels and rims its unmixed radiance is wrong by more than its
# standard errors, and was up to 4.5 times that of a white surface. Thin lamps are brighter.
LEAST_RESIDUAL_MIXED = 0.8
# Highlights move with the view: where a triangle is not marked, or no pure pixel supports it,
# at least this number of views must support emission.
LEAST_SUPPORTING = 2
# Triangles without evidence emit if more than this share of their component's area with evidence does.
MAJORITY = 0.5
# `brighter_than_white`: by how much, as white surfaces are, too, by noise; most pixels of all views.
BRIGHTER, MOST_COMPARED = 1.1, 200_000


def find_emission(
    room: Room,
    pixels: PixelStore,
    shadings: ShadingStore,
    marked: np.ndarray,
    known: np.ndarray,
    estimate: Callable[[np.ndarray], np.ndarray],
    surfaces: EmitterSurfaces,
) -> np.ndarray:
    """(T,) bool, triangles that emit, by the majority of their pixels or of their connected component.

    Marked triangles, of which most pixels are much brighter than white, emit where the estimate can't explain
    their radiance. Others may be lamps that are only a little brighter than lit surfaces: they emit if at
    least two views show them brighter than any material (:func:`most_reflected`).

    Args:
        shadings: of all pixels.
        marked: (T,) bool, triangles that look like emitters (:func:`.material.closed_form.fit_cells`).
        known: (T,) int8, 1 on triangles that emit in any case (parts of view-independent radiance, hints), -1
            on those that hints say do not; 0 elsewhere.
        estimate: (R,) pixels to their (R, 3) reflected radiance L_r of the estimate.
        surfaces: what emits as a whole.
    """
    least, unit = surfaces.least_residual, surfaces.unit
    marked = surfaces.most(marked, pixels)
    evidence = Evidence.none(int(unit.max(initial=-1)) + 1)
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        triangle, own, weight = (np.asarray(a[rows]) for a in (pixels.triangle, pixels.own, pixels.weight))
        size = pixels.views[index].height, pixels.views[index].width
        reflected = _reflected(shadings, rows, triangle, own, marked, estimate)
        if surfaces.reach:
            reflected = most_nearby(reflected, triangle >= 0, size, surfaces.reach)
        error = _doubt(own, weight)
        hit = (triangle >= 0) & (weight > 0.0)
        dark = relative_residual(own * (1.0 + error[:, None]), reflected) < least
        evidence.oppose(unit[triangle[hit & dark]], weight[hit & dark])
        brightest = neighbourhood_maximum(np.asarray(pixels.radiance[rows]) @ LUMINANCE, size)
        sure = own * np.maximum(1.0 - error, 0.0)[:, None]
        fraction = spill_free_fraction(sure @ LUMINANCE, brightest)
        pure = np.asarray(pixels.pure[rows])
        needed = np.where(pure, least, max(least, LEAST_RESIDUAL_MIXED))
        bright = hit & (relative_residual(sure * fraction[:, None], reflected) >= needed)
        evidence.support(unit[triangle[bright]], weight[bright], pure[bright])
    seen_once = (marked & evidence.pure[unit]) | (evidence.views >= LEAST_SUPPORTING)[unit]
    emits = evidence.majority[unit] & seen_once
    decided = emits | (evidence.exists & ~evidence.majority)[unit] | (known != 0)
    emits = (emits | (known > 0)) & (known >= 0)
    return extend_to_components(room.areas, surfaces.component, emits, decided)


def _doubt(own: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) share of unmixed radiances (n, 3) of weights (n,) that may be an error."""
    return DOUBT * standard_error(own, weight) / np.maximum(own.mean(axis=1), 1e-12)


@dataclass(frozen=True)
class Evidence:
    """Sums for each of U surfaces.

    Attributes:
        supporting: (U,) weight of the pixels that support emission.
        opposing: (U,) weight of the pixels that reflection explains.
        views: (U,) number of views with supporting pixels.
        pure: (U,) bool, whether a pure pixel supports emission.
    """

    supporting: np.ndarray
    opposing: np.ndarray
    views: np.ndarray
    pure: np.ndarray

    @classmethod
    def none(cls, surfaces: int) -> Evidence:
        """No evidence for any of so many surfaces."""
        supporting, opposing = np.zeros((2, surfaces))
        return cls(supporting, opposing, np.zeros(surfaces, np.int64), np.zeros(surfaces, bool))

    def support(self, surface: np.ndarray, weight: np.ndarray, pure: np.ndarray) -> None:
        """Add supporting pixels of one view: the surfaces that they see, their weights, whether pure."""
        np.add.at(self.supporting, surface, weight)
        self.views[np.unique(surface)] += 1
        self.pure[surface[pure]] = True

    def oppose(self, surface: np.ndarray, weight: np.ndarray) -> None:
        """Add opposing pixels: the surfaces that they see, and their weights."""
        np.add.at(self.opposing, surface, weight)

    @property
    def majority(self) -> np.ndarray:
        """(U,) bool, most pixels support emission."""
        return self.supporting > self.opposing

    @property
    def exists(self) -> np.ndarray:
        """(U,) bool, there is a pixel for or against emission."""
        return self.supporting + self.opposing > 0


def _reflected(
    shadings: ShadingStore,
    rows: slice,
    triangle: np.ndarray,
    radiance: np.ndarray,
    marked: np.ndarray,
    estimate: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """(n, 3) radiance of a view's pixels that reflection explains; of white surfaces where that suffices."""
    reflected = np.array(shadings.diffuse[rows], np.float32)  # a copy, to be written to
    bright = (triangle >= 0) & (relative_residual(radiance, reflected) >= LEAST_RESIDUAL)
    on_marked = (triangle >= 0) & marked[np.maximum(triangle, 0)]
    unmarked = np.flatnonzero(bright & ~on_marked)
    specular = np.asarray(shadings.specular[unmarked + rows.start], np.float32)
    reflected[unmarked] = most_reflected(reflected[unmarked], specular)
    estimated = np.flatnonzero(on_marked)
    reflected[estimated] = estimate(estimated + rows.start)
    return reflected


def most_reflected(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """(N, 3) upper bound of L_r over all base colours, roughness levels and metallic values (paper Eq. 5).

    Eq. 5 is linear in a and in m, so its maximum is at a = 1 and m = 0 or 1.

    Args:
        diffuse: (N, 3) L_d. specular: (N, K, 2, 3) L_s0 and L_s1.
    """
    s0, s1 = specular[:, :, 0], specular[:, :, 1]
    return (np.maximum(diffuse[:, None] + DIELECTRIC_REFLECTANCE * s0, s0) + s1).max(axis=1)


def most_nearby(reflected: np.ndarray, hit: np.ndarray, size: tuple[int, int], reach: int) -> np.ndarray:
    """(n, 3) largest of reflected radiances (n, 3) within `reach` pixels that hit the mesh, in each channel.

    Args:
        hit: (n,) bool. size: (height, width) of the view.
    """
    image = np.where(hit[:, None], reflected, 0.0).reshape(*size, 3)
    width = 2 * reach + 1
    return np.asarray(maximum_filter(image, (width, width, 1), mode="nearest")).reshape(-1, 3)


def relative_residual(radiance: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """(N,) share of the luminance of (N, 3) radiances that exceeds the reflected ones, channel by channel."""
    luminance = radiance @ LUMINANCE
    return np.maximum(radiance - reflected, 0.0) @ LUMINANCE / np.maximum(luminance, 1e-12)


def neighbourhood_maximum(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(n,) maximum over the 3 x 3 pixels around each pixel of a view of `size` (height, width)."""
    return maximum_filter(values.reshape(size), size=3, mode="nearest").reshape(-1)


def spill_free_fraction(luminance: np.ndarray, brightest: np.ndarray) -> np.ndarray:
    """(n,) lower bound of the share of a pure pixel's light that comes from its surface.

    Args:
        luminance: (n,) of the pixels.
        brightest: (n,) maximum in the neighbourhood, from which light may spill over.
    """
    remaining = (luminance - SPILL * brightest) / (1.0 - SPILL)
    return np.clip(remaining / np.maximum(luminance, 1e-12), 0.0, 1.0)


def extend_to_components(
    areas: np.ndarray, component: np.ndarray, emits: np.ndarray, decided: np.ndarray
) -> np.ndarray:
    """(T,) bool, the emitters, and undecided triangles of components that mostly emit.

    Args:
        areas: (T,) square metres.
        component: (T,) int connected component of the mesh, from 0.
        emits: (T,) bool, emitters.
        decided: (T,) bool, triangles with evidence.
    """
    decided_area = np.bincount(component, areas * decided)
    emitting_area = np.bincount(component, areas * (decided & emits))
    mostly = emitting_area > MAJORITY * np.maximum(decided_area, 1e-30)
    return emits | (~decided & mostly[component])


def brighter_than_white(pixels: PixelStore, shadings: ShadingStore) -> float:
    """Share of the pixels that are brighter than a white diffuse surface in the light that was baked.

    With the shadings of stage 1 it is the share of lamps and highlights, unless light comes from lamps that
    no photograph shows. Evenly spaced pixels stand for all.
    """
    rows = np.arange(0, len(pixels), max(1, len(pixels) // MOST_COMPARED))
    rows = rows[np.asarray(pixels.weight[rows]) > 0.0]
    diffuse = np.asarray(shadings.diffuse[rows], np.float32) @ LUMINANCE
    return float(np.mean(np.asarray(pixels.own[rows]) @ LUMINANCE > BRIGHTER * diffuse)) if len(rows) else 0.0
