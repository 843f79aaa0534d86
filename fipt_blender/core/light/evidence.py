# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The evidence of single pixels: bounds of the radiance of their surface, and the most that it could reflect.
:mod:`.emission` weighs it.

The bounds exclude light that may come from another surface: what spills over from neighbouring pixels, and
the error of the unmixed radiance of a mixed pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ..optics.lights import LUMINANCE
from ..pixels.store import PixelStore
from ..pixels.unmixing import NOISE, standard_error
from .baking import ShadingStore

# Share of a pure pixel's light that may spill over from its neighbours: half where coplanar surfaces meet at
# its centre, 16 to 30 % by a camera's blur (a Gaussian of half a pixel).
SPILL = 0.5
# `brighter_than_white`: least factor (noise makes white surfaces brighter, too), and most pixels compared.
BRIGHTER, MAX_COMPARED = 1.1, 200_000


@dataclass(frozen=True)
class PixelEvidence:
    """N pixels that see the mesh, view by view.

    Attributes:
        unit: (N,) int surface that each sees. view: (N,) int. pure: (N,) bool.
        weight: (N,) float32 information of `own`, 1 for pure pixels.
        own: (N, 3) float32 radiance of the surface, in units of the capture's median.
        low, high: (N,) float32 factors of `own` between which the true radiance lies.
        reflected: (N, 3) float32 most that the surface reflects.
        diffuse: (N,) float32 luminance of L_d.
    """

    unit: np.ndarray
    view: np.ndarray
    pure: np.ndarray
    weight: np.ndarray
    own: np.ndarray
    low: np.ndarray
    high: np.ndarray
    reflected: np.ndarray
    diffuse: np.ndarray


def read_evidence(
    pixels: PixelStore,
    shadings: ShadingStore,
    white: Callable[[np.ndarray], np.ndarray],
    unit: np.ndarray,
    reach: int,
) -> PixelEvidence:
    """All pixels with a known radiance.

    Args:
        white: (R,) pixels to the (R, 3) most that a surface of the gloss of theirs reflects.
        unit: (T,) int surface of each triangle.
        reach: largest distance in pixels between the surface that a pixel shows and the one that it hits.
    """
    found = []
    for index, view in enumerate(pixels.views):
        rows, size = pixels.rows(index), (view.height, view.width)
        triangle, own, weight = (np.asarray(a[rows]) for a in (pixels.triangle, pixels.own, pixels.weight))
        diffuse = np.asarray(shadings.diffuse[rows], np.float32)
        reflected = white(np.arange(rows.start, rows.stop))
        if reach:
            reflected = most_nearby(reflected, triangle >= 0, size, reach)
        error = standard_error(own, weight) / np.maximum(own.mean(axis=1), 1e-12)
        low = np.maximum(1.0 - error, 0.0)
        luminance = (np.asarray(pixels.radiance[rows]) @ LUMINANCE).reshape(size)
        brightest = maximum_filter(luminance, size=3, mode="nearest").reshape(-1)
        low *= spill_free_fraction(low * (own @ LUMINANCE), brightest) * (1.0 - NOISE)
        high = (1.0 + error) * (1.0 + NOISE)
        hit = np.flatnonzero((triangle >= 0) & (weight > 0.0))
        columns = (
            np.asarray(pixels.pure[rows]),
            weight,
            own,
            low,
            high,
            reflected,
            diffuse @ LUMINANCE,
        )
        of_view = [
            np.asarray(column[hit], column.dtype if column.dtype == bool else np.float32)
            for column in columns
        ]
        found.append((unit[triangle[hit]], np.full(len(hit), index), *of_view))
    return PixelEvidence(*(np.concatenate(column) for column in zip(*found, strict=True)))


def log_ratio(radiance: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """(N,) logarithm of the luminance of radiances (N, 3) over what reflection explains of it (N, 3).

    Where a channel is brighter than reflection, the others count as explained: a red lamp under white light
    may be as dark as a wall.
    """
    luminance = radiance @ LUMINANCE
    explained = np.where(
        (radiance > reflected).any(axis=1), np.minimum(radiance, reflected) @ LUMINANCE, reflected @ LUMINANCE
    )
    return np.asarray(np.log(np.maximum(luminance, 1e-6) / np.maximum(explained, 1e-6)))


def most_nearby(reflected: np.ndarray, hit: np.ndarray, size: tuple[int, int], reach: int) -> np.ndarray:
    """(n, 3) largest of reflected radiances (n, 3) within `reach` pixels that hit the mesh, in each channel.

    Args:
        hit: (n,) bool. size: (height, width) of the view.
    """
    image = np.where(hit[:, None], reflected, 0.0).reshape(*size, 3)
    width = 2 * reach + 1
    return np.asarray(maximum_filter(image, (width, width, 1), mode="nearest")).reshape(-1, 3)


def spill_free_fraction(luminance: np.ndarray, brightest: np.ndarray) -> np.ndarray:
    """(n,) lower bound of the share of a pure pixel's light that comes from its surface.

    Args:
        luminance: (n,) of the pixels.
        brightest: (n,) maximum in the neighbourhood, from which light may spill over.
    """
    remaining = (luminance - SPILL * brightest) / (1.0 - SPILL)
    return np.clip(remaining / np.maximum(luminance, 1e-12), 0.0, 1.0)


def brighter_than_white(pixels: PixelStore, shadings: ShadingStore) -> float:
    """Share of the mesh's pixels that are brighter than a white diffuse surface in the light that was baked.

    With the shadings of stage 1 it is the share of lamps and highlights, unless light comes from lamps that
    no photograph shows. Evenly spaced pixels stand for all.
    """
    rows = np.arange(0, len(pixels), max(1, len(pixels) // MAX_COMPARED))
    rows = rows[(np.asarray(pixels.weight[rows]) > 0.0) & (np.asarray(pixels.triangle[rows]) >= 0)]
    diffuse = np.asarray(shadings.diffuse[rows], np.float32) @ LUMINANCE
    return float(np.mean(np.asarray(pixels.own[rows]) @ LUMINANCE > BRIGHTER * diffuse)) if len(rows) else 0.0
