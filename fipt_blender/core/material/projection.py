# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the closed forms share: the rendering is linear in base colour, which least squares determine."""

from __future__ import annotations

import numpy as np

from ..light.baking import ShadingStore
from ..optics.factorised import color_line, level_share


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
