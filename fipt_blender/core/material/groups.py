# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups that take the place of parts where no part masks exist.

Surfaces of one semantic class, one connected piece of the mesh and one colour are likely of one material. The
paper's kernel for semantic masks (Eq. 20) rests on the same idea.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parts.labels import Parts
from ..pixels.grouped import grouped_weighted_median, numbered
from ..run.store import Gaps

NO_GROUP = -1  # in place of a group
# Added to base colours before they are compared, because their errors are about as large on dark surfaces as
# on bright ones.
COLOR_LIFT = 0.05
BRIGHTNESS_STEP = 1.0  # stops
CHROMA_STEP = 0.1  # width of the classes of chroma
# Largest number of groups, so that arrays over pairs of groups do not grow with the capture: one has at least
# this share of all pixels.
MOST_GROUPS = 2000
# Standard deviation of the base colours of similar groups, in stops.
SIMILAR_COLOR = 0.15
# A piece is of one material if the roughness and metallic of this share of its pixels is within SAME_MATERIAL
# of their medians.
SAME_SHARE = 0.9
SAME_MATERIAL = 0.1


@dataclass(frozen=True)
class Units:
    """The finest known division of the mesh into surfaces.

    Attributes:
        triangle: (T,) int32 unit of each triangle from 0, NO_PART without one.
        single: (units,) bool, whether it is of one material.
        fixed: (units, 2) roughness and metallic that hints have decided, NaN elsewhere; None without hints.
    """

    triangle: np.ndarray
    single: np.ndarray
    fixed: Gaps | None = None

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


def material_groups(
    label: np.ndarray, piece: np.ndarray, color: np.ndarray, pixels: np.ndarray, least: int
) -> np.ndarray:
    """(N,) int32 group of each kind of pixel from 0, NO_GROUP for those that are in no group large enough.

    The finest group that is large enough counts: class, piece and colour; else class and piece; else class
    and colour.

    Args:
        label: (N,) int semantic class; a constant where there is none.
        piece: (N,) int connected piece of the mesh.
        color: (N,) int :func:`color_class`.
        pixels: (N,) int number of pixels of each kind.
        least: number of pixels that a group must have.
    """
    group = np.full(len(label), NO_GROUP, np.int64)
    used = 0
    for columns in ((label, piece, color), (label, piece), (label, color)):
        key = numbered(columns)
        count = np.bincount(key, pixels)
        assigned = (group < 0) & (count[key] >= least)
        group[assigned] = used + key[assigned]
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
    materials: np.ndarray,
    divided: bool = True,
) -> Units:
    """Units where no parts are known: connected pieces of the mesh that are of one material, else classes.

    In a piece of several materials, such as a mirror with its frame, the triangles of the most frequent one
    are a unit, then those of the next, as long as they have a tenth of the piece's pixels.

    Args:
        parts: semantic classes, or none.
        pieces: (T,) int connected piece of each triangle.
        triangle, group, pixels: (K,) int, the number of pixels that see a triangle and belong to a group
            (NO_GROUP for none).
        materials: (G + 1, 2) roughness and metallic of the groups; the last row, at -1, is of no group.
        divided: whether pieces of several materials are; otherwise they are no units.
    """
    label, piece = parts.triangle_part, numbered([parts.triangle_part, pieces])
    place = piece[triangle]
    size = np.bincount(place, pixels, minlength=int(piece.max(initial=-1)) + 1)
    unit, classes = label.astype(np.int64), int(label.max(initial=-1)) + 1
    units, free = classes, np.ones(len(piece), bool)
    while True:
        seen = pixels * free[triangle]
        alike = _most_frequent(materials[group], seen * (group >= 0), place)
        found = free & (_share(place, seen, alike, len(size)) >= SAME_SHARE)[piece]
        if divided:
            found |= free & (_share(triangle, seen, alike, len(piece)) >= SAME_SHARE)
        of_unit = np.bincount(place, seen * found[triangle], minlength=len(size))
        found &= ((of_unit > 0) & (of_unit >= (1.0 - SAME_SHARE) * size))[piece]
        if not found.any():
            return Units(unit.astype(np.int32), np.arange(units) >= classes)
        number = numbered([piece[found]])
        unit[found] = units + number
        units += int(number.max()) + 1
        free &= ~found


def _most_frequent(values: np.ndarray, pixels: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """(K,) bool, whether values (K, 2) are within SAME_MATERIAL of the medians of their piece (K,)."""
    alike = pixels > 0
    for column in values.T:
        medians = grouped_weighted_median(column, pixels, piece, int(piece.max(initial=-1)) + 1)
        alike &= np.abs(column - medians[piece]) < SAME_MATERIAL
    return alike


def _share(number: np.ndarray, pixels: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """(count,) share of the pixels (K,) with a number (K,) that are chosen (K,), 0 without any."""
    total = np.bincount(number, pixels, minlength=count)
    return np.bincount(number, pixels * chosen, minlength=count) / np.maximum(total, 1)


def similarity(label: np.ndarray, color: np.ndarray) -> np.ndarray:
    """(G, G) prior probability that two groups are of one material: of one class and similar colour.

    Args:
        label: (G,) int semantic class; a constant where there is none.
        color: (G, 3) base colour.
    """
    stops = np.log2(color + COLOR_LIFT)
    squared = sum((column[:, None] - column) ** 2 for column in stops.T) / 3.0
    return np.exp(-0.5 * squared / SIMILAR_COLOR**2) * (label[:, None] == label)
