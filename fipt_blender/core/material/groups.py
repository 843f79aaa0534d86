# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups that stand for parts where no mask tells them: surfaces of one class, one piece of the mesh and one
colour are likely of one material. The paper's kernel for semantic masks (Eq. 17) rests on the same idea.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

NO_GROUP = -1
# Pixels of a group: fewer say too little about a gloss.
LEAST_PIXELS = 1000
DARKEST = 0.02
BRIGHTNESS_STEP = 1.0  # stops
CHROMA_STEP = 0.1
# Groups at most: what is kept of pairs of them must not grow with the capture.
MOST_GROUPS = 2000
# How far apart the base colours of kin lie, in stops; darker than this all colours are alike.
KIN_COLOR = 0.15
KIN_DARK = 0.05


def color_class(color: np.ndarray) -> np.ndarray:
    """(N,) int64 class of each base colour (N, 3): a step of brightness and of chromaticity."""
    brightness = np.round(np.log2(np.maximum(color.mean(axis=1), DARKEST)) / BRIGHTNESS_STEP)
    total = np.maximum(color.sum(axis=1, keepdims=True), 1e-3)
    chroma = np.round(color[:, :2] / total / CHROMA_STEP)
    return (brightness * 10_000 + chroma[:, 0] * 100 + chroma[:, 1]).astype(np.int64)


def numbered(columns: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) int64 from 0, a number for each combination of the values of int columns (N,)."""
    number = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        values = np.unique(column, return_inverse=True)[1]
        number = np.unique(number * (int(values.max(initial=0)) + 1) + values, return_inverse=True)[1]
    return number


def material_groups(
    label: np.ndarray, piece: np.ndarray, color: np.ndarray, pixels: np.ndarray, least: int
) -> np.ndarray:
    """(N,) int32 group of each kind of pixel from 0, NO_GROUP for those that nothing large enough takes in.

    The finest group that is large enough counts: class, piece and colour; else class and piece; else class
    and colour.

    Args:
        label: (N,) int semantic class, the same for all where there is none.
        piece: (N,) int connected piece of the mesh.
        color: (N,) int :func:`color_class`.
        pixels: (N,) int how many there are of each kind.
        least: pixels that a group must have.
    """
    group = np.full(len(label), NO_GROUP, np.int64)
    used = 0
    for columns in ((label, piece, color), (label, piece), (label, color)):
        key = numbered(columns)
        count = np.bincount(key, pixels)
        taken = (group < 0) & (count[key] >= least)
        group[taken] = used + key[taken]
        used += len(count)
    known = group >= 0
    result = np.full(len(label), NO_GROUP, np.int32)
    result[known] = np.unique(group[known], return_inverse=True)[1]
    return result


def kinship(label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) in [0, 1], how likely two groups are of one material beforehand: of one class and like colour.

    Args:
        label: (G,) int semantic class, the same for all where there is none.
        color: (G, 3) base colour.
    """
    stops = np.log2(color + KIN_DARK)
    squared = sum((column[:, None] - column) ** 2 for column in stops.T) / 3.0
    return np.exp(-0.5 * squared / KIN_COLOR**2) * (label[:, None] == label)
