# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups that stand for parts where no mask tells them: surfaces of one class, one piece of the mesh and one
colour are likely of one material. The paper's kernel for semantic masks (Eq. 17) rests on the same idea.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.labels import Parts

NO_GROUP = -1
# Pixels of a group: fewer say too little about a gloss.
LEAST_PIXELS = 1000
# Errors of base colour are about as large in dark surfaces as in bright ones: colours are compared with so
# much added to them.
COLOR_LIFT = 0.05
BRIGHTNESS_STEP = 1.0  # stops
CHROMA_STEP = 0.1
# Groups at most: what is kept of pairs of them must not grow with the capture.
MOST_GROUPS = 2000
# How far apart the base colours of kin lie, in stops.
KIN_COLOR = 0.15
# A piece of which so many pixels have the same roughness and metallic, within so much, is of one material.
SAME_SHARE = 0.9
SAME_MATERIAL = 0.1


@dataclass(frozen=True)
class Units:
    """The finest parts of the mesh that are known.

    Attributes:
        triangle: (T,) int32 unit of each triangle from 0, NO_PART without one.
        single: (units,) bool, whether it is of one material.
    """

    triangle: np.ndarray
    single: np.ndarray

    def is_single(self, unit: np.ndarray) -> np.ndarray:
        """Whether units (any shape; negative for none) are of one material."""
        return np.append(self.single, False)[np.maximum(unit, -1)]


def part_units(parts: Parts) -> Units:
    """Units where parts are known: each is one material."""
    return Units(parts.triangle_part, np.ones(int(parts.triangle_part.max(initial=-1)) + 1, bool))


def color_class(color: np.ndarray) -> np.ndarray:
    """(N,) int64 class of each base colour (N, 3): a step of brightness and of chromaticity."""
    lifted = color + COLOR_LIFT
    brightness = np.round(np.log2(lifted.mean(axis=1)) / BRIGHTNESS_STEP)
    chroma = np.round(lifted[:, :2] / lifted.sum(axis=1, keepdims=True) / CHROMA_STEP)
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


def piece_units(
    parts: Parts,
    pieces: np.ndarray,
    triangle: np.ndarray,
    group: np.ndarray,
    pixels: np.ndarray,
    roughness: np.ndarray,
    metallic: np.ndarray,
) -> Units:
    """Units where no masks tell parts: pieces of the mesh that are of one material, or else classes.

    Args:
        parts: semantic classes, or none.
        pieces: (T,) int connected piece of each triangle.
        triangle: (K,) int, group: (K,) int, NO_GROUP without: what is seen, in so many pixels (K,).
        roughness, metallic: (G,) of the groups.
    """
    label = parts.triangle_part
    classes = int(label.max(initial=-1)) + 1
    unit = numbered([label, pieces])
    of = unit[triangle]
    count = np.bincount(of, pixels, minlength=int(unit.max(initial=-1)) + 1)
    # Pixels without a group agree with nobody.
    alike = group >= 0
    for values in (roughness, metallic):
        own = np.append(values, 0.0)[group]
        alike &= np.abs(own - _medians(own, pixels * (group >= 0), of, len(count))[of]) < SAME_MATERIAL
    single = (np.bincount(of, pixels * alike, minlength=len(count)) >= SAME_SHARE * count) & (count > 0)
    number = classes + np.cumsum(single) - 1
    return Units(
        np.where(single[unit], number[unit], label).astype(np.int32),
        np.concatenate([np.zeros(classes, bool), np.ones(int(single.sum()), bool)]),
    )


def _medians(values: np.ndarray, weight: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """(count,) weighted medians of values (K,) by their index (K,); 0 for those without any weight."""
    order = np.lexsort((values, index))
    total = np.cumsum(weight[order])
    own = np.bincount(index, weight, minlength=count)
    half = np.cumsum(own) - 0.5 * own
    place = np.minimum(np.searchsorted(total, half), max(len(values) - 1, 0))
    return np.where(own > 0, values[order][place] if len(values) else 0.0, 0.0)


def kinship(label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) in [0, 1], how likely two groups are of one material beforehand: of one class and like colour.

    Args:
        label: (G,) int semantic class, the same for all where there is none.
        color: (G, 3) base colour.
    """
    stops = np.log2(color + COLOR_LIFT)
    squared = sum((column[:, None] - column) ** 2 for column in stops.T) / 3.0
    return np.exp(-0.5 * squared / KIN_COLOR**2) * (label[:, None] == label)
