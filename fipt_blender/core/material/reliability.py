# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail of the base colour of parts, shrunk at each scale by its reliability (split-half correlation).

The views are divided into two halves. What both show at the same places is texture or an error of the light
that all views share, of which the standard errors tell the size; what they don't share is noise. Band-passes
of the base colours, an octave each, are multiplied by the share of their power that is texture (a Wiener
filter), and a part without any texture has its median everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..pixels.grouped import grouped_median, grouped_sums, place_of
from ..surface.smoothing import SmoothingGrid
from .confidence import FLOOR
from .seen import Box

# Cells of the finest low-pass filter in widths of a pixel, as for the detail of photographs, and of the
# windows in which power is measured in cells of the filter.
FINEST, WINDOW = 2.5, 4.0
# Power that the halves share may be chance up to this share of the power that they don't: two standard errors
# of the covariance of noise in the forty independent cells of a window.
CHANCE = 0.3
# The power of errors in the n cells of a part may be larger than expected by so many times n^-0.5.
ERRORS = 2.0


@dataclass(frozen=True)
class PlaceColors:
    """Base colours of K pieces of the surface of parts, each about as wide as a pixel.

    Attributes:
        position: (K, 3) metres.
        part: (K,) int from 0.
        color: (K, 3) of the estimate.
        halves: (2, K, 3) from the photographs of each half of the views.
        weight: (2, K) of these, 0 where a half saw nothing.
        error: (K,) standard error that all views have in common.
    """

    position: np.ndarray
    part: np.ndarray
    color: np.ndarray
    halves: np.ndarray
    weight: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class PartDetail:
    """How base colours of P parts are shrunk, at N nodes of a grid with a cell about two pixels wide.

    Attributes:
        median: (P, 3), NaN for parts that stay as they are.
        width: of a cell, metres.
        keys: (N,) int64 of the nodes (:class:`.SmoothingGrid`).
        sums: (N, 9) weighted sums of the low-pass filtered color (3), of the reliability of what is finer and
            of the next octave, of what coarser octaves add to the median (3), and of the weights.
    """

    median: np.ndarray
    width: float
    keys: np.ndarray
    sums: np.ndarray

    def shrink(self, values: np.ndarray, position: np.ndarray, part: np.ndarray, box: Box) -> np.ndarray:
        """(N, 3) float32 base colours with their detail as far as it is reliable.

        Args:
            values: (N, 3) of the estimate.
            position: (N, 3) metres, in the box.
            part: (N,) int, negative for none.
        """
        result = np.asarray(values, np.float32).copy()
        known = np.flatnonzero(np.append(np.isfinite(self.median[:, 0]), False)[np.maximum(part, -1)])
        if not len(known):
            return result
        grid = _grid(position[known], part[known], self.width, box)
        read = _read(grid, position[known], self.keys, self.sums)
        seen = read[:, 8] > 0.0
        smooth, finer, coarser, rest = np.split(read[seen, :8] / read[seen, 8:], [3, 4, 5], axis=1)
        result[known] = median = self.median[part[known]]
        smooth_offset = coarser * (smooth - median[seen]) + rest
        result[known[seen]] += finer * (values[known[seen]] - smooth) + smooth_offset
        return np.clip(result, 0.0, 1.0)


def part_detail(places: PlaceColors, median: np.ndarray, footprint: float, box: Box) -> PartDetail:
    """The reliable detail of parts.

    Args:
        median: (P, 3) base colour of each part, NaN for those that stay as they are.
        footprint: median width of a pixel, metres.
    """
    position, part = places.position, places.part
    octaves = max(int(np.log2(box.extent / (FINEST * footprint))), 1)
    rows, ones = np.arange(len(part)), np.ones(len(part))
    # Both halves must have seen much, in light that is known; errors are spread evenly over the octaves.
    both = places.weight[0] * places.weight[1] / np.maximum(places.weight.sum(axis=0), 1e-30)
    both /= places.error**2 + FLOOR**2
    light = places.error**2 / (octaves + 1)
    area = np.bincount(part[both > 0.0], minlength=len(median)) * footprint**2
    weights = [ones, *places.weight]
    finer = [places.color, *places.halves]
    levels: list[tuple[SmoothingGrid, np.ndarray]] = []
    for octave in range(octaves):
        width = FINEST * footprint * 2.0**octave
        grid = _grid(position, part, width, box)
        coarser = [grid.smooth(rows, position, *pair) for pair in zip(weights, finer, strict=True)]
        powers = _powers(finer, coarser, light)
        windows = _grid(position, part, WINDOW * width, box)
        excess = ERRORS / np.sqrt(np.maximum(area / width**2, 1.0))
        reliable = _reliability(windows.smooth(rows, position, both, powers), part, excess)
        sums = grid.spread(rows, position, ones, np.column_stack([finer[0], reliable]))
        levels.append((grid, sums))
        finer = coarser
    powers = _powers(finer, [median[part]] * 3, light)
    whole = grouped_sums(both[:, None] * powers, part, len(median))
    reliable = _reliability(whole, np.arange(len(median)), np.full(len(median), ERRORS))

    # Coarser octaves are smooth: their shrunk colours are kept at the finest nodes.
    (finest, fine_sums), *others = levels
    position, part = finest.places()
    smooth = offset = np.zeros((len(part), 3))  # from the median: what coarser octaves are, and are shrunk to
    reliability = reliable[part][:, None]
    for grid, sums in reversed(others):
        read = _read(_grid(position, part, grid.width, box), position, grid.keys, sums)
        read = read[:, :4] / np.maximum(read[:, 4:], 1e-30)
        nearer = read[:, :3] - median[part]
        offset = offset + reliability * (nearer - smooth)
        smooth, reliability = nearer, read[:, 3:]
    weight = fine_sums[:, 4:]
    rest = weight * np.column_stack([reliability, offset - reliability * smooth])
    kept = np.column_stack([fine_sums[:, :4], rest, weight])
    return PartDetail(median, finest.width, finest.keys, kept.astype(np.float32))


def _grid(position: np.ndarray, part: np.ndarray, width: float, box: Box) -> SmoothingGrid:
    # Nodes of wide grids are nodes of narrow ones, too.
    return SmoothingGrid.around(position, part, np.arange(len(part)), width, box.low)


def _read(grid: SmoothingGrid, position: np.ndarray, keys: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """(n, C) sums (N, C) of nodes of these keys, at points of another grid of the same nodes."""
    place = place_of(keys, grid.keys)
    there = np.where(place[:, None] >= 0, sums[place], 0.0)
    return grid.read(np.arange(len(position)), position, there)


def _powers(finer: list[np.ndarray], coarser: list[np.ndarray], light: np.ndarray) -> np.ndarray:
    """(K, 4) powers of a band: what both halves show, what they don't share, the estimate's; the errors'.

    Args:
        finer, coarser: (K, 3) of the estimate and of both halves, with the band and without.
        light: (K,) of errors that the halves share.
    """
    whole, one, other = (above - below for above, below in zip(finer, coarser, strict=True))
    apart = 0.5 * ((one - other) ** 2).mean(axis=1)
    return np.stack([(one * other).mean(axis=1), apart, (whole**2).mean(axis=1), light], axis=1)


def _reliability(powers: np.ndarray, part: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """(K,) share of the power of a band that is texture, 0 unless that is certain.

    What is typical of a part is as much evidence as the window itself.

    Args:
        powers: (K, 4) means or sums of :func:`_powers`.
        excess: (P,) of the errors' power, as a share of it, that would be no surprise.
    """
    shared, apart, power, light = powers.T
    texture = np.maximum(shared - light, 0.0)
    doubt = CHANCE * apart + excess[part] * light
    both = np.stack([shared - light, doubt], axis=1)
    evidence, doubted = (both + grouped_median(both, part, len(excess))[part]).T
    certain = np.clip(evidence / np.maximum(doubted, 1e-30) - 1.0, 0.0, 1.0)
    # The estimate is not noisier than the mean of both halves.
    noise = np.clip(power - texture, 0.0, 0.5 * apart)
    return certain * texture / np.maximum(texture + noise, 1e-30)
