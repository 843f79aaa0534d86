# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed-form start for the networks, by variable projection.

The factorised rendering (paper Eq. 5) is linear in base colour once roughness and metallic are given. So for
each pair of roughness and metallic the best base colour of each surface cell, which several views see, has a
closed form, and the pair with the least residual over a part is the part's best guess. The networks start
there instead of from noise; everything after is the paper's optimisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# A part is metal or not. Values between would only lower the 4 % of dielectrics where shadings are wrong.
METALLIC_CANDIDATES = (0.0, 1.0)
# Residuals are relative to radiance; darker than this share of the median counts absolutely.
DARK = 0.05
# How much the robust cost of a specular surface must be below that of a diffuse one: the l_d of Eq. 14.
DIFFUSE_PRIOR = 0.004
# Standard errors by which a gain over the diffuse candidate is discounted.
CAUTION = 1.0
# Photographed radiance above this multiple of what a white surface would reflect is emission.
CLEAR_EMISSION = 1.5
# A part whose radiance spreads less than this share of its irradiance's spread emits. Surfaces of the
# example rooms stay above 0.5, their lamps below 0.01.
CONSTANT_RATIO = 0.15
CONSTANT_IRRADIANCE = 0.05
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


def project(
    radiance: np.ndarray,
    diffuse: np.ndarray,
    specular: np.ndarray,
    levels: np.ndarray,
    cell: np.ndarray,
    part: np.ndarray,
) -> Guess:
    """Best base colour of each cell and best roughness and metallic of each part.

    Args:
        radiance: (N, 3) photographed radiance, in units of the capture's median.
        diffuse: (N, 3) L_d.
        specular: (N, K, 2, 3) L_s0 and L_s1 at `levels`.
        levels: (K,) roughness.
        cell: (N,) int surface cell of each pixel.
        part: (N,) int part of each pixel, negative without: those are taken as diffuse.
    """
    key = cell.astype(np.int64) * (int(part.max(initial=0)) + 2) + part + 1
    _, cell_id = np.unique(key, return_inverse=True)
    cells = int(cell_id.max(initial=-1)) + 1
    parts = int(part.max(initial=-1)) + 1
    known = part >= 0
    shared = np.bincount(cell_id, minlength=cells)[cell_id] > 1  # a cell of one pixel fits everything
    counted = known & shared
    weight = 1.0 / (radiance + DARK) ** 2
    scale = np.full(parts, np.inf)
    diffuse_cost: np.ndarray | None = None
    totals = np.empty((len(levels), len(METALLIC_CANDIDATES), parts))
    # The diffuse candidate comes first: its median residual sets each part's scale.
    for k in reversed(range(len(levels))):
        for j, m in enumerate(METALLIC_CANDIDATES):
            slope, offset = _line(diffuse, specular[:, k], m)
            color = _fit(radiance, slope, offset, weight, cell_id, cells)
            residual = radiance - offset - color[cell_id] * slope
            squared = (residual**2 * weight).mean(axis=1)[counted]
            if np.isinf(scale).any():
                scale = _median_by(part[counted], squared, parts)
            # Cauchy's cost: a part of the pixels (edges, stray shadings) never follows the model.
            cost = np.log1p(squared / scale[part[counted]])
            if diffuse_cost is None:
                diffuse_cost = cost
            prior = DIFFUSE_PRIOR * ((1.0 - levels[k]) + m)
            totals[k, j] = prior + _cautious_mean(cost - diffuse_cost, part[counted], parts)
    roughness, metallic = _best_pair(totals, levels)
    pixel_roughness = np.where(known, roughness[np.maximum(part, 0)] if parts else 1.0, 1.0)
    pixel_metallic = np.where(known, metallic[np.maximum(part, 0)] if parts else 0.0, 0.0)
    chosen = np.abs(levels[None, :] - pixel_roughness[:, None]).argmin(axis=1)
    slope, offset = _line(diffuse, specular[np.arange(len(chosen)), chosen], pixel_metallic[:, None])
    color = _fit(radiance, slope, offset, weight, cell_id, cells)
    # A white surface, of this roughness and metallic or diffuse: metals mirror lamps without being lamps.
    white = np.maximum(diffuse, slope) + offset
    emitting = (radiance > CLEAR_EMISSION * white).all(axis=1) & (radiance.mean(axis=1) > 1.0)
    part_emits = constant_parts(radiance.mean(axis=1), diffuse.mean(axis=1), part, parts)
    if parts:
        emitting |= known & part_emits[np.maximum(part, 0)]
    return Guess(
        color[cell_id].astype(np.float32),
        pixel_roughness.astype(np.float32),
        pixel_metallic.astype(np.float32),
        emitting,
        roughness,
        metallic,
        part_emits,
    )


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
        result[index] = lit > CONSTANT_IRRADIANCE and seen < CONSTANT_RATIO * lit
    return result


def _spread(values: np.ndarray) -> float:
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return float((high - low) / middle) if middle > 0.0 else 0.0


def _best_pair(totals: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roughness and metallic of least cost for each part, the roughness refined between levels.

    Args:
        totals: (K, M, parts) cost of each roughness level and metallic candidate.
    """
    count, candidates, parts = totals.shape
    if not parts:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    best = totals.reshape(-1, parts).argmin(axis=0)
    k, j = best // candidates, best % candidates
    index = np.arange(parts)
    inner = np.clip(k, 1, count - 2)
    x = np.stack([levels[inner - 1], levels[inner], levels[inner + 1]]).astype(np.float64)
    y = np.stack([totals[inner + step, j, index] for step in (-1, 0, 1)])
    # Vertex of the parabola through the best level and its neighbours.
    d0, d2 = x[1] - x[0], x[1] - x[2]
    top = d0**2 * (y[1] - y[2]) - d2**2 * (y[1] - y[0])
    bottom = d0 * (y[1] - y[2]) - d2 * (y[1] - y[0])
    vertex = x[1] - 0.5 * top / np.where(np.abs(bottom) > 1e-15, bottom, np.inf)
    refined = np.where(k == inner, np.clip(vertex, x[0], x[2]), levels[k])
    return refined.astype(np.float32), np.array(METALLIC_CANDIDATES, np.float32)[j]


def _cautious_mean(gain: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) mean of each part's values plus `CAUTION` standard errors: few pixels prove little."""
    count = np.maximum(np.bincount(part, minlength=parts), 1)
    mean = np.bincount(part, gain, minlength=parts) / count
    variance = np.bincount(part, gain**2, minlength=parts) / count - mean**2
    return mean + CAUTION * np.sqrt(np.maximum(variance, 0.0) / count)


def _median_by(group: np.ndarray, values: np.ndarray, groups: int) -> np.ndarray:
    """(groups,) median of the values of each group; 1 for empty groups."""
    order = np.lexsort((values, group))
    count = np.bincount(group, minlength=groups)
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, max(len(values) - 1, 0))
    medians = values[order][middle] if len(values) else np.ones(groups)
    return np.where(count > 0, np.maximum(medians, 1e-12), 1.0)


def _line(
    diffuse: np.ndarray, specular: np.ndarray, metallic: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(slope, offset) of L_r = slope a + offset for given shadings, each (N, 3)."""
    s0, s1 = specular[:, 0], specular[:, 1]
    return (1.0 - metallic) * diffuse + metallic * s0, 0.04 * (1.0 - metallic) * s0 + s1


def _fit(
    radiance: np.ndarray,
    slope: np.ndarray,
    offset: np.ndarray,
    weight: np.ndarray,
    cell: np.ndarray,
    cells: int,
) -> np.ndarray:
    """(cells, 3) weighted least-squares base colour of each cell, in [0, 1]."""
    color = np.empty((cells, 3))
    for channel in range(3):
        w, a = weight[:, channel], slope[:, channel]
        top = np.bincount(cell, w * a * (radiance[:, channel] - offset[:, channel]), minlength=cells)
        bottom = np.bincount(cell, w * a * a, minlength=cells)
        color[:, channel] = top / np.maximum(bottom, 1e-12)
    return np.clip(color, 0.0, 1.0)
