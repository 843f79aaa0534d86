# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the closed forms share: the rendering is linear in base colour, which least squares determine.

Parts of constant radiance, which no base colour explains, are recognised here, too.
"""

from __future__ import annotations

import numpy as np

from ..light.baking import ShadingStore
from ..optics.factorised import color_line, level_share
from ..scene.grouped import rows_of_groups

# A part emits if the relative spread of its radiance is less than this share of that of its irradiance. In
# the example rooms surfaces stay above 0.5 and lamps below 0.01.
CONSTANT_RATIO = 0.15
# Least relative spread of irradiance for that test: noise of shadings of very few samples reaches 0.040, and
# a wide panel far from all other lamps receives 0.052. Largest relative spread of radiance (noisy shadings
# spread without limit), and least number of pixels.
CONSTANT_IRRADIANCE = 0.042
CONSTANT_SPREAD = 0.3
CONSTANT_PIXELS = 30


def color_lines(
    shadings: ShadingStore, levels: np.ndarray, rows: np.ndarray, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(R, 3) slope and offset of the rendering, slope a + offset, of some pixels at a material of each.

    Args:
        shadings: at the roughness `levels` (K,); may be memory-mapped.
        rows: (R,) pixels. material: (R, 2) roughness and metallic.
    """
    roughness, metallic = material[:, 0], material[:, 1:]
    upper = np.clip(np.searchsorted(levels, roughness), 1, len(levels) - 1)
    low, high = levels[upper - 1], levels[upper]
    share = level_share(np.clip(roughness, low, high), low, high).astype(np.float32)[:, None, None]
    below, above = (np.asarray(shadings.specular[rows, level], np.float32) for level in (upper - 1, upper))
    s0, s1 = np.moveaxis(below + share * (above - below), 1, 0)
    return color_line(np.asarray(shadings.diffuse[rows], np.float32), s0, s1, metallic)


def constant_parts(radiance: np.ndarray, irradiance: np.ndarray, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) bool, parts whose radiance is constant although the light that falls on them varies.

    No reflection does that, so even a dim lamp is recognised. The relative spread is the distance between the
    10th and the 90th percentile divided by the median, which excludes edges and noise.

    Args:
        radiance, irradiance: (N,) mean over the channels.
        part: (N,) int, negative for none.
    """
    result = np.zeros(parts, bool)
    for index, rows in enumerate(rows_of_groups(part, parts)):
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
