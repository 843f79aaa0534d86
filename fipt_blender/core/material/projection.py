"""What the closed forms share: the rendering is linear in base colour, which least squares determine."""

from __future__ import annotations

import numpy as np

from ..light.baking import ShadingStore
from ..optics.factorised import color_line, level_share
from ..pixels.grouped import grouped_sums


def lower_levels(levels: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R,) int64 baked level (K,) below each roughness (R,), and the float32 share of the next one in it."""
    lower = np.clip(np.searchsorted(levels, roughness) - 1, 0, len(levels) - 2)
    low, high = levels[lower], levels[lower + 1]
    return lower, level_share(np.clip(roughness, low, high), low, high).astype(np.float32)


def color_lines(
    shadings: ShadingStore, rows: np.ndarray, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(R, 3) slope and offset of the rendering, slope a + offset, of some pixels at a material of each.

    Args:
        shadings: may be memory-mapped.
        rows: (R,) pixels. material: (R, 2) roughness and metallic.
    """
    lower, share = lower_levels(shadings.levels, material[:, 0])
    below, above = (np.asarray(shadings.specular[rows, level], np.float32) for level in (lower, lower + 1))
    s0, s1 = np.moveaxis(below + share[:, None, None] * (above - below), 1, 0)
    return color_line(np.asarray(shadings.diffuse[rows], np.float32), s0, s1, material[:, 1:])


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
    weighted = weight * slope
    top = grouped_sums(weighted * (radiance - offset), cell)
    return np.clip(top / np.maximum(grouped_sums(weighted * slope, cell), 1e-12), 0.0, 1.0)
