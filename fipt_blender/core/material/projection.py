# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rendering as a line in base colour, and the base colours that fit it best.

For given roughness and metallic, the factorised rendering (paper Eq. 5) is linear in base colour, so that the
least-squares base colour of each surface cell has a closed form. Its residuals tell which pair of roughness
and metallic fits a part best (likelihood.py).
"""

from __future__ import annotations

import numpy as np

from ..optics.factorised import level_share

# Residuals are relative to radiance plus this, in units of the capture's median radiance.
RADIANCE_FLOOR = 0.05
# A group emits if the relative spread of its radiance is less than this share of that of its irradiance. In
# the example rooms surfaces stay above 0.5 and lamps below 0.01.
CONSTANT_RATIO = 0.15
# Least relative spread of irradiance for that test: noise of shadings of very few samples reaches 0.040, and
# a wide panel far from all other lamps receives 0.052. Largest relative spread of radiance (noisy shadings
# spread without limit), and least number of pixels.
CONSTANT_IRRADIANCE = 0.042
CONSTANT_SPREAD = 0.3
CONSTANT_PIXELS = 30


def cells_of_groups(cell: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(N,) int from 0, a number for each pair of a surface cell (N,) and a group (N,), negative for none."""
    key = cell.astype(np.int64) * (int(group.max(initial=0)) + 2) + group + 1
    return np.unique(key, return_inverse=True)[1]


def residual_weight(radiance: np.ndarray) -> np.ndarray:
    """Weight of squared residuals, the same shape: they count relative to the photographed radiance."""
    return 1.0 / (radiance + RADIANCE_FLOOR) ** 2


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


def constant_groups(
    radiance: np.ndarray, irradiance: np.ndarray, group: np.ndarray, groups: int
) -> np.ndarray:
    """(groups,) bool, groups whose radiance is constant although the light that falls on them varies.

    No reflection does that, so even a dim lamp is recognised. The relative spread is the distance between the
    10th and the 90th percentile divided by the median, which excludes edges and noise.

    Args:
        radiance, irradiance: (N,) mean over the channels.
        group: (N,) int, negative for none.
    """
    result = np.zeros(groups, bool)
    order = np.argsort(group, kind="stable")
    bounds = np.searchsorted(group[order], np.arange(groups + 1))
    for index in range(groups):
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
