# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed-form initial estimate for the networks, by variable projection.

For given roughness and metallic, the factorised rendering (paper Eq. 5) is linear in base colour. The
least-squares base colour of each surface cell therefore has a closed form, and its residuals tell which pair
of roughness and metallic fits a part best (mixture.py). The networks start from this estimate instead of
random values; the optimisation that follows is the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..optics.factorised import color_line, level_share
from .pixel_samples import PixelSamples

# A part emits if the relative spread of its radiance is less than this share of that of its irradiance. In
# the example rooms surfaces stay above 0.5 and lamps below 0.01.
CONSTANT_RATIO = 0.15
# Least relative spread of irradiance for that test: noise of shadings of very few samples reaches 0.040, and
# a wide panel far from all other lamps receives 0.052. Largest relative spread of radiance (noisy shadings
# spread without limit), and least number of pixels.
CONSTANT_IRRADIANCE = 0.042
CONSTANT_SPREAD = 0.3
CONSTANT_PIXELS = 30


@dataclass(frozen=True)
class InitialEstimate:
    """Initial values for N pixels.

    Attributes:
        rows: (N,) int64 indices among the pixels of the run.
        values: (N, 5) float32 base colour of the pixel's cell, roughness and metallic of its group.
        part_emits: (parts,) bool, parts whose radiance does not follow irradiance (:func:`constant_parts`);
            empty where groups take the place of parts.
    """

    rows: np.ndarray
    values: np.ndarray
    part_emits: np.ndarray


def cells_of_groups(cell: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(N,) int from 0, a number for each pair of a surface cell (N,) and a group (N,), negative for none."""
    key = cell.astype(np.int64) * (int(group.max(initial=0)) + 2) + group + 1
    return np.unique(key, return_inverse=True)[1]


def specular_at(
    specular: np.ndarray, rows: np.ndarray, levels: np.ndarray, roughness: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(R, 3) L_s0 and (R, 3) L_s1, float32, of some pixels at a roughness of each.

    Args:
        specular: (N, K, 2, 3) at the `levels` (K,); may be memory-mapped.
        rows: (R,) pixels. roughness: (R,).
    """
    upper = np.clip(np.searchsorted(levels, roughness), 1, len(levels) - 1)
    low, high = levels[upper - 1], levels[upper]
    share = level_share(np.clip(roughness, low, high), low, high).astype(np.float32)[:, None, None]
    below, above = (np.asarray(specular[rows, level], np.float32) for level in (upper - 1, upper))
    s0, s1 = np.moveaxis(below + share * (above - below), 1, 0)
    return s0, s1


def project(
    samples: PixelSamples, group_roughness: np.ndarray, group_metallic: np.ndarray, known_parts: bool = True
) -> InitialEstimate:
    """The best base colour of each cell, given the roughness and metallic of each group.

    Args:
        samples: N pixels; those without a group are taken as diffuse.
        group_roughness, group_metallic: (groups,) float32 (:func:`.mixture.infer_materials`).
        known_parts: whether groups are known parts. Other groups may hold pixels of a lamp and of a wall of
            one colour, and do not tell which parts emit.
    """
    groups, group = len(group_roughness), samples.group
    known = group >= 0
    cell = cells_of_groups(samples.cell, group)
    roughness = np.where(known, group_roughness[np.maximum(group, 0)] if groups else 1.0, 1.0)
    metallic = np.where(known, group_metallic[np.maximum(group, 0)] if groups else 0.0, 0.0)
    s0, s1 = specular_at(samples.specular, np.arange(len(group)), samples.levels, roughness)
    slope, offset = color_line(samples.diffuse, s0, s1, metallic[:, None])
    color = fit_colors(samples.radiance, slope, offset, samples.square_weight, cell)
    part_emits = np.zeros(0, bool)
    if known_parts:
        part_emits = constant_parts(
            samples.radiance.mean(axis=1), samples.diffuse.mean(axis=1), group, groups
        )
    values = np.column_stack([color[cell], roughness, metallic]).astype(np.float32)
    return InitialEstimate(samples.rows, values, part_emits)


def constant_parts(radiance: np.ndarray, irradiance: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) bool, parts whose radiance is constant although the light that falls on them varies.

    No reflection does that, so even a dim lamp is recognised. The relative spread is the distance between the
    10th and the 90th percentile divided by the median, which excludes edges and noise.

    Args:
        radiance, irradiance: (N,) mean over the channels.
        part: (N,) int, negative for none.
    """
    result = np.zeros(parts, bool)
    order = np.argsort(part, kind="stable")
    bounds = np.searchsorted(part[order], np.arange(parts + 1))
    for index in range(parts):
        rows = order[bounds[index] : bounds[index + 1]]
        if len(rows) < CONSTANT_PIXELS:
            continue
        emitted, received = (_relative_spread(values[rows]) for values in (radiance, irradiance))
        varies = received > CONSTANT_IRRADIANCE
        result[index] = varies and emitted < min(CONSTANT_RATIO * received, CONSTANT_SPREAD)
    return result


def _relative_spread(values: np.ndarray) -> float:
    low, median, high = np.quantile(values, [0.1, 0.5, 0.9])
    return float((high - low) / median) if median > 0.0 else 0.0


def fit_colors(
    radiance: np.ndarray, slope: np.ndarray, offset: np.ndarray, weight: np.ndarray, cell: np.ndarray
) -> np.ndarray:
    """(cells, 3) weighted least-squares base colour of each cell, in [0, 1].

    Args:
        radiance: (N, 3) photographed.
        slope, offset: (N, 3) of the rendering, slope a + offset.
        weight: (N, 3) of the squared residuals.
        cell: (N,) int from 0.
    """
    cells = int(cell.max(initial=-1)) + 1
    color = np.empty((cells, 3))
    for channel in range(3):
        w, a = weight[:, channel], slope[:, channel]
        top = np.bincount(cell, w * a * (radiance[:, channel] - offset[:, channel]), minlength=cells)
        bottom = np.bincount(cell, w * a * a, minlength=cells)
        color[:, channel] = top / np.maximum(bottom, 1e-12)
    return np.clip(color, 0.0, 1.0)
