"""Detail of the base colour of parts, shrunk at each scale by its reliability (split-half correlation).

The views are divided into two halves. What both show at the same places is texture or an error of the light
that all views share, of which the standard errors tell the size. Band-passes of the base colours, an octave
each, are multiplied by the share of that power which is above these errors (a Wiener filter), and a part
without any texture has its median everywhere.

Where a whole room has large standard errors, poses or exposures are wrong, which is no reason to take
patterns off its walls: errors then tell only where the estimate is better, and where worse, than elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parts.labels import NO_PART
from ..pixels.grouped import (
    grouped_means,
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
# Weight of a place that only one half has seen, beside 1: it counts only where there is no other.
ALONE = 1e-6
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
    both = (places.weight > 0.0).all(axis=0)
    telling = np.where(both, 1.0, ALONE)
    variance = places.error**2
    # Errors that are large in the whole room are not of the light alone.
    of_light = min(1.0, FLOOR**2 / max(float(variance.mean()), 1e-30))
    light = variance * (of_light / (octaves + 1))  # spread evenly over the octaves
    weights = [ones, *places.weight]
    finer = [places.color, *places.halves]
    levels: list[tuple[SmoothingGrid, np.ndarray]] = []
    for octave in range(octaves):
        width = FINEST * footprint * 2.0**octave
        grid = _grid(position, part, width, box)
        coarser = [grid.smooth(rows, position, *pair) for pair in zip(weights, finer, strict=True)]
        powers = _powers(finer, coarser, light, both)
        local = _grid(position, part, WINDOW * width, box).smooth(rows, position, telling, powers)
        reliable = _reliability(local, _of_parts(powers, telling, part))
        sums = grid.spread(rows, position, ones, np.column_stack([finer[0], reliable]))
        levels.append((grid, sums))
        finer = coarser
    whole = _of_parts(_powers(finer, [median[part]] * 3, light, both), telling, part)
    reliable = _reliability(whole, whole)

    # Coarser octaves are smooth: their shrunk colours are kept at the finest nodes.
    (finest, fine_sums), *others = levels
    reliability = finest.spread(rows, position, ones, reliable)
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


def _of_parts(powers: np.ndarray, weight: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(K, C) weighted means of powers (K, C) in the part of each."""
    sums = grouped_sums(weight[:, None] * np.column_stack([powers, np.ones(len(part))]), part)[part]
    return sums[:, :-1] / sums[:, -1:]


def _powers(
    finer: list[np.ndarray], coarser: list[np.ndarray], light: np.ndarray, both: np.ndarray
) -> np.ndarray:
    """(K, 2) powers of a band: what both halves show, or all that one half has seen alone, and the errors'.

    Args:
        finer, coarser: (K, 3) of the estimate and of both halves, with the band and without.
        light: (K,) of errors that the halves share.
        both: (K,) bool, whether both have seen a place.
    """
    whole, one, other = (above - below for above, below in zip(finer, coarser, strict=True))
    shared = np.where(both[:, None], one * other, whole**2).mean(axis=1)
    return np.column_stack([shared, light])


def _reliability(local: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(K, 1) share of a band that is texture.

    What is typical of a part is as much evidence of texture as the window itself.

    Args:
        local, whole: (K, 2) powers (:func:`_powers`) in the window and in the part.
    """
    shared = np.sqrt(np.maximum(local[:, :1], 0.0) * np.maximum(whole[:, :1], 0.0))
    return np.maximum(shared - local[:, 1:], 0.0) / np.maximum(shared, 1e-30)
