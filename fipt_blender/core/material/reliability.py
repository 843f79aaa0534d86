# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Detail of the base colour of parts, shrunk at each scale by its reliability (split-half correlation).

The views are divided into two halves. What both show at the same places is texture or an error of the light
that all views share, of which the standard errors tell the size; what they don't share is noise. Band-passes
of the base colours, an octave each, are multiplied by the share of their power that is texture (a Wiener
filter), and a part without any texture has its median everywhere. Where the halves tell little, because few
photographs show a part or few cells of a coarse octave lie on it, a prior decides, by which detail stays that
is far above the noise, or as sure as what is finer at the same place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parts.labels import NO_PART
from ..pixels.grouped import (
    grouped_means,
    grouped_median,
    grouped_sums,
    grouped_weighted_median,
    numbered,
    pairs_of,
    place_of,
)
from ..surface.smoothing import SmoothingGrid
from .cell_errors import DrawnPixels
from .closed_form import TrainingData
from .confidence import FLOOR
from .groups import Units
from .networks import Fields
from .pixel_samples import residual_weight
from .projection import color_lines
from .seen import Box, SeenCells

# Cells of the finest low-pass filter in widths of a pixel, as for the detail of photographs, and of the
# windows in which power is measured in cells of the filter.
FINEST, WINDOW = 2.5, 4.0
# Power that the halves share may be chance up to this share of the power that they don't: two standard errors
# of the covariance of noise in the forty independent cells of a window.
CHANCE = 0.3
# Cells that both halves must see of a part to tell as much as the prior: as many as in a window.
PRIOR_CELLS = 40.0
# Smallest and largest base colour of a pixel, whose light may be wrong.
MIN_COLOR, MAX_COLOR = -0.5, 2.0


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


def room_detail(
    drawn: DrawnPixels,
    data: TrainingData,
    units: Units,
    fields: Fields,
    cells: SeenCells,
    errors: np.ndarray,
) -> PartDetail | None:
    """The reliable detail of all units of one material; None where no pixel sees such a unit.

    Args:
        drawn: pixels. data: with the last shadings.
        errors: (C, 3) standard errors in the cells.
    """
    median = part_medians(units, fields, cells, errors)
    rows = np.flatnonzero(np.append(np.isfinite(median[:, 0]), False)[np.maximum(drawn.unit, NO_PART)])
    if not len(rows):
        return None
    pixels, box = drawn.rows[rows], fields.box
    position, unit = drawn.position[rows], drawn.unit[rows]
    footprint = data.observations.footprint
    values = fields.query(position, unit)
    slope, offset = color_lines(data.shadings, pixels, values[:, 3:])
    radiance = data.observations.pixels.own[pixels]
    color = np.clip((radiance - offset) / np.maximum(slope, 1e-6), MIN_COLOR, MAX_COLOR)
    # By the part's median, so that the dark places of a pattern don't weigh more than the bright ones.
    weight = (residual_weight(slope * median[unit] + offset) * slope**2).mean(axis=1)
    cell = np.floor((position - box.low) / footprint).astype(np.int64)
    place = numbered([unit, *cell.T])
    variance = np.maximum(errors[drawn.cells[drawn.place[rows]], 0].astype(float) ** 2 - FLOOR**2, 0.0)
    of_unit, _, pair = pairs_of(unit, data.observations.pixels.view_of(pixels))
    # Halves of each unit's own views: of all views, maybe only those of one half see a unit.
    half = ((np.arange(len(of_unit)) - np.searchsorted(of_unit, of_unit)) % 2)[pair]
    in_half = np.stack([weight * (half == number) for number in range(2)])
    sums = np.stack([grouped_sums(np.column_stack([w[:, None] * color, w]), place) for w in in_half])
    count = sums.shape[1]
    means = grouped_means(np.column_stack([position, values[:, :3], variance]), place)
    part = np.zeros(count, np.int64)
    part[place] = unit
    halves = sums[..., :3] / np.maximum(sums[..., 3:], 1e-30)
    found = PlaceColors(means[:, :3], part, means[:, 3:6], halves, sums[..., 3], np.sqrt(means[:, 6]))
    return part_detail(found, median, footprint, box)


def part_medians(units: Units, fields: Fields, cells: SeenCells, errors: np.ndarray) -> np.ndarray:
    """(units, 3) median base colour of each unit of one material, NaN without any; by the cells' errors."""
    single = units.is_single(cells.part)
    part = cells.part[single]
    color = fields.query(cells.points[single], part)[:, :3]
    weight = 1.0 / np.maximum(errors[single, 0].astype(float), FLOOR) ** 2
    count = len(units.single)
    median = np.stack([grouped_weighted_median(column, weight, part, count) for column in color.T], axis=1)
    median[np.bincount(part, minlength=count) == 0] = np.nan
    return median


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
    seen = np.bincount(part[both > 0.0], minlength=len(median)) / FINEST**2
    weights = [ones, *places.weight]
    finer = [places.color, *places.halves]
    found = np.zeros((len(part), 2))
    levels: list[tuple[SmoothingGrid, np.ndarray]] = []
    for octave in range(octaves):
        width = FINEST * footprint * 2.0**octave
        grid = _grid(position, part, width, box)
        coarser = [grid.smooth(rows, position, *pair) for pair in zip(weights, finer, strict=True)]
        powers = _powers(finer, coarser, light, both)
        local = _grid(position, part, WINDOW * width, box).smooth(rows, position, ones, powers)
        whole = np.nan_to_num(grouped_means(powers, part, len(median)))
        reliable, found = _reliability(local, part, whole, (seen, seen / 4.0**octave), found)
        sums = grid.spread(rows, position, ones, np.column_stack([finer[0], reliable]))
        levels.append((grid, sums))
        finer = coarser
    powers = _powers(finer, [median[part]] * 3, light, both)
    whole = np.nan_to_num(grouped_means(powers, part, len(median)))
    reliable, _ = _reliability(whole[part], part, whole, (seen, np.ones(len(median))), found)

    # Coarser octaves are smooth: their shrunk colours are kept at the finest nodes.
    (finest, fine_sums), *others = levels
    reliability = finest.spread(rows, position, ones, reliable[:, None])
    reliability = reliability[:, :1] / np.maximum(reliability[:, 1:], 1e-30)
    position, part = finest.places()
    smooth = offset = np.zeros((len(part), 3))  # from the median: what coarser octaves are, and are shrunk to
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


def _powers(
    finer: list[np.ndarray], coarser: list[np.ndarray], light: np.ndarray, both: np.ndarray
) -> np.ndarray:
    """(K, 8) powers of a band: what both halves show, what they don't share, the estimate's, the errors'.

    These four are weighted by what both halves saw. That weight follows, whether it is above 0, and the last
    two powers without it.

    Args:
        finer, coarser: (K, 3) of the estimate and of both halves, with the band and without.
        light: (K,) of errors that the halves share.
        both: (K,) weight.
    """
    whole, one, other = (above - below for above, below in zip(finer, coarser, strict=True))
    shared, apart = (one * other).mean(axis=1), 0.5 * ((one - other) ** 2).mean(axis=1)
    power = (whole**2).mean(axis=1)
    weighted = [both * each for each in (shared, apart, power, light)]
    return np.stack([*weighted, both, both > 0.0, power, light], axis=1)


def _reliability(
    powers: np.ndarray,
    part: np.ndarray,
    whole: np.ndarray,
    cells: tuple[np.ndarray, np.ndarray],
    found: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(K,) share of the power of a band that is texture, and `found` with this band.

    It is measured in windows that both halves have seen; what is typical of a part is as much evidence of
    texture as the window itself. The fewer cells of a part they have seen, the more its prior counts: the
    share in the finer bands there, as errors of light have few of these, or, if they have hardly seen the
    part at all, the share of its power that is above the usual noise of this band in the room. What only one
    half has seen of a window is as reliable as is typical of the part.

    Args:
        powers: (K, 8) means of :func:`_powers` in windows.
        part: (K,) int from 0.
        whole: (P, 8) means in whole parts.
        cells: (P,) each, how many that both halves have seen of the finest band, and of this one.
        found: (K, 2) power of texture and power in the finer bands.
    """
    seen = powers[:, 4] > 0.0
    shared, apart, power, light = powers[:, :4].T / np.maximum(powers[:, 4], 1e-30)
    both = np.stack([shared - light, CHANCE * apart], axis=1)
    evidence, doubt = (both + grouped_median(both, part, len(whole))[part]).T
    certain = np.clip(evidence / np.maximum(doubt, 1e-30) - 1.0, 0.0, 1.0)
    texture = np.maximum(shared - light, 0.0)
    # The estimate is not noisier than the mean of both halves.
    noise = np.clip(power - texture, 0.0, 0.5 * apart)
    measured = certain * texture / np.maximum(texture + noise, 1e-30)
    usual = np.median(apart[seen]) if seen.any() else 0.0
    prior = np.clip(1.0 - (usual + whole[:, 7]) / np.maximum(whole[:, 6], 1e-30), 0.0, 1.0)
    in_part, in_band = (number / (number + PRIOR_CELLS) for number in cells)
    finer = found[:, 0] / np.maximum(found[:, 1], 1e-30)
    prior = prior[part] + np.where(found[:, 1] > 0.0, in_part[part], 0.0) * (finer - prior[part])
    measured = prior + np.where(seen, in_band[part], 0.0) * (measured - prior)
    typical = grouped_median(measured, part, len(whole))[part]
    reliable = typical + powers[:, 5] * (measured - typical)
    return reliable, found + powers[:, 6:7] * np.column_stack([reliable, np.ones(len(part))])
