# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed-form start for the networks, by variable projection.

The factorised rendering (paper Eq. 5) is linear in base colour once roughness and metallic are given. So for
each pair of roughness and metallic the best base colour of each surface cell, which several views see, has a
closed form, and what it leaves unexplained tells which pair is the part's (gloss.py). The networks start
there instead of from noise; everything after is the paper's optimisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Residuals are relative to radiance; darker than this share of the median counts absolutely.
DARK = 0.05
# Photographed radiance above this multiple of what a white surface would reflect is emission.
CLEAR_EMISSION = 1.5
# A part whose radiance spreads less than this share of its irradiance's spread emits. Surfaces of the
# example rooms stay above 0.5, their lamps below 0.01.
CONSTANT_RATIO = 0.15
CONSTANT_IRRADIANCE = 0.05
# ... and never more than this share of its own median: noisy shadings spread without end.
CONSTANT_SPREAD = 0.3
CONSTANT_PIXELS = 30


@dataclass(frozen=True)
class Guess:
    """Start values for N pixels.

    Attributes:
        base_color: (N, 3) float32 of the pixel's cell.
        roughness: (N,) float32 of the pixel's part.
        metallic: (N,) float32 of the pixel's part.
        emitting: (N,) bool, brighter than any reflection.
        part_roughness: (parts,) float32.
        part_metallic: (parts,) float32.
        part_emits: (parts,) bool, radiance that does not follow irradiance (:func:`constant_parts`).
    """

    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    emitting: np.ndarray
    part_roughness: np.ndarray
    part_metallic: np.ndarray
    part_emits: np.ndarray


def cells_of_parts(cell: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(N,) int from 0, one for each pair of a surface cell and a part."""
    key = cell.astype(np.int64) * (int(part.max(initial=0)) + 2) + part + 1
    return np.unique(key, return_inverse=True)[1]


def project(
    radiance: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    levels: np.ndarray,
    cell: np.ndarray,
    part: np.ndarray,
    part_roughness: np.ndarray,
    part_metallic: np.ndarray,
    whole: bool = True,
) -> Guess:
    """Best base colour of each cell, given each part's roughness and metallic (:func:`gloss.part_materials`).

    Args:
        radiance: (N, 3) photographed radiance, in units of the capture's median.
        diffuse: (N, 3) L_d.
        specular: (N, K, 2, 3) L_s0 and L_s1 at `levels`.
        levels: (K,) roughness.
        cell: (N,) int surface cell of each pixel.
        part: (N,) int part of each pixel, negative without: those are taken as diffuse.
        part_roughness, part_metallic: (parts,) float32.
        whole: whether parts are what somebody marked; other groups may be a lamp's and a wall's pixels of one
            colour, and say nothing about emission.
    """
    parts = len(part_roughness)
    known = part >= 0
    cell_id = cells_of_parts(cell, part)
    weight = 1.0 / (radiance + DARK) ** 2
    pixel_roughness = np.where(known, part_roughness[np.maximum(part, 0)] if parts else 1.0, 1.0)
    pixel_metallic = np.where(known, part_metallic[np.maximum(part, 0)] if parts else 0.0, 0.0)
    chosen = np.abs(levels[None, :] - pixel_roughness[:, None]).argmin(axis=1)
    slope, offset = line(diffuse, specular[np.arange(len(chosen)), chosen], pixel_metallic[:, None])
    color = fit_colors(radiance, slope, offset, weight, cell_id)
    # A white surface, of this roughness and metallic or diffuse: metals mirror lamps without being lamps.
    white = np.maximum(diffuse, slope) + offset
    emitting = (radiance > CLEAR_EMISSION * white).all(axis=1) & (radiance.mean(axis=1) > 1.0)
    part_emits = np.zeros(0, bool)
    if whole:
        part_emits = constant_parts(radiance.mean(axis=1), diffuse.mean(axis=1), part, parts)
    if len(part_emits):
        emitting |= known & part_emits[np.maximum(part, 0)]
    return Guess(
        color[cell_id].astype(np.float32),
        pixel_roughness.astype(np.float32),
        pixel_metallic.astype(np.float32),
        emitting,
        part_roughness,
        part_metallic,
        part_emits,
    )


def window_means(
    arrays: Sequence[np.ndarray],
    rows: np.ndarray,
    usable: np.ndarray,
    part: np.ndarray,
    ranges: np.ndarray,
    widths: np.ndarray,
) -> list[np.ndarray]:
    """Means over the 3 × 3 pixels around some pixels, of those of the same part and view.

    The rendering is linear in the shadings, so means of both sides agree where base colour is even; noise is
    less, and the structure of its errors, which differs between roughness levels, with it.

    Args:
        arrays: each (N, ...), of all pixels, view after view in rows of the image; may be memory-mapped.
        rows: (M,) int pixels wanted.
        usable: (N,) bool, pixels that see one surface; part: (N,) int.
        ranges: (views + 1,) int first pixel of each view, and N.
        widths: (views,) int pixels of each view's rows.

    Returns:
        (M, ...) float32 each.
    """
    sums = [np.zeros((len(rows), *array.shape[1:]), np.float32) for array in arrays]
    count = np.zeros(len(rows), np.float32)
    view = np.searchsorted(ranges, rows, side="right") - 1
    first, end, width, own_part = ranges[view], ranges[view + 1], widths[view], part[rows]
    column = (rows - first) % width
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            other = rows + down * width + right
            inside = (other >= first) & (other < end) & (column + right >= 0) & (column + right < width)
            other = np.where(inside, other, rows)
            taken = inside & (part[other] == own_part) & usable[other]
            taken |= (down == 0) & (right == 0)
            chosen = np.flatnonzero(taken)
            for total, array in zip(sums, arrays, strict=True):
                total[chosen] += array[other[chosen]]
            count[chosen] += 1.0
    return [total / count.reshape(-1, *[1] * (total.ndim - 1)) for total in sums]


def constant_parts(radiance: np.ndarray, irradiance: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) bool, parts that shine alike from everywhere although the light that falls on them varies.

    No reflection does that, however dim the lamp is. The spread is that between the 10th and 90th percentile
    against the median; edges and noise lie outside.

    Args:
        radiance, irradiance: (N,) grey, of the pixels.
        part: (N,) int, negative without.
    """
    result = np.zeros(parts, bool)
    order = np.argsort(part, kind="stable")
    bounds = np.searchsorted(part[order], np.arange(parts + 1))
    for index in range(parts):
        rows = order[bounds[index] : bounds[index + 1]]
        if len(rows) < CONSTANT_PIXELS:
            continue
        seen, lit = (_spread(values[rows]) for values in (radiance, irradiance))
        result[index] = lit > CONSTANT_IRRADIANCE and seen < min(CONSTANT_RATIO * lit, CONSTANT_SPREAD)
    return result


def _spread(values: np.ndarray) -> float:
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return float((high - low) / middle) if middle > 0.0 else 0.0


def line(
    diffuse: np.ndarray, specular: np.ndarray, metallic: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(slope, offset) of L_r = slope a + offset for given shadings, each (N, 3)."""
    s0, s1 = specular[:, 0], specular[:, 1]
    return (1.0 - metallic) * diffuse + metallic * s0, 0.04 * (1.0 - metallic) * s0 + s1


def fit_colors(
    radiance: np.ndarray,
    slope: np.ndarray,
    offset: np.ndarray,
    weight: np.ndarray,
    cell: np.ndarray,
) -> np.ndarray:
    """(cells, 3) weighted least-squares base colour of each cell, in [0, 1]."""
    cells = int(cell.max(initial=-1)) + 1
    color = np.empty((cells, 3))
    for channel in range(3):
        w, a = weight[:, channel], slope[:, channel]
        top = np.bincount(cell, w * a * (radiance[:, channel] - offset[:, channel]), minlength=cells)
        bottom = np.bincount(cell, w * a * a, minlength=cells)
        color[:, channel] = top / np.maximum(bottom, 1e-12)
    return np.clip(color, 0.0, 1.0)
