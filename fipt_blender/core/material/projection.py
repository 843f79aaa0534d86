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

# Metallic is almost always 0 or 1; one value between catches mixtures of both.
METALLIC_CANDIDATES = (0.0, 0.5, 1.0)
# Residuals are relative to radiance; darker than this share of the median counts absolutely.
DARK = 0.05
# How much larger the mean squared relative residual may be for a surface that is diffuse: the l_d of Eq. 14.
DIFFUSE_PRIOR = 1e-3
# Photographs of emitters do not follow the rendering; residuals stop counting here (robust loss).
LARGEST_RESIDUAL = 0.25


@dataclass(frozen=True)
class Guess:
    """Start values for N pixels.

    Attributes:
        base_color: (N, 3) float32 of the pixel's cell.
        roughness: (N,) float32 of the pixel's part.
        metallic: (N,) float32 of the pixel's part.
    """

    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray


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
    population = np.maximum(np.bincount(part[counted], minlength=parts), 1)
    weight = 1.0 / (radiance + DARK) ** 2
    best = np.full(parts, np.inf)
    roughness = np.ones(parts, np.float32)
    metallic = np.zeros(parts, np.float32)
    for k in range(len(levels)):
        for m in METALLIC_CANDIDATES:
            slope, offset = _line(diffuse, specular[:, k], m)
            color = _fit(radiance, slope, offset, weight, cell_id, cells)
            residual = radiance - offset - color[cell_id] * slope
            cost = np.minimum((residual**2 * weight).mean(axis=1), LARGEST_RESIDUAL)
            total = np.bincount(part[counted], cost[counted], minlength=parts) / population
            total += DIFFUSE_PRIOR * ((1.0 - levels[k]) + m)
            better = total < best
            best[better] = total[better]
            roughness[better], metallic[better] = levels[k], m
    pixel_roughness = np.where(known, roughness[np.maximum(part, 0)] if parts else 1.0, 1.0)
    pixel_metallic = np.where(known, metallic[np.maximum(part, 0)] if parts else 0.0, 0.0)
    chosen = np.abs(levels[None, :] - pixel_roughness[:, None]).argmin(axis=1)
    slope, offset = _line(diffuse, specular[np.arange(len(chosen)), chosen], pixel_metallic[:, None])
    color = _fit(radiance, slope, offset, weight, cell_id, cells)
    return Guess(
        color[cell_id].astype(np.float32),
        pixel_roughness.astype(np.float32),
        pixel_metallic.astype(np.float32),
    )


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
