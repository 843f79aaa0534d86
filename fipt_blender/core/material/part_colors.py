# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The base colours of parts as two halves of the views show them, for the reliability of their detail."""

from __future__ import annotations

import numpy as np

from ..parts.labels import NO_PART
from ..pixels.grouped import grouped_means, grouped_sums, grouped_weighted_median, numbered, pairs_of
from .cell_errors import DrawnPixels
from .closed_form import TrainingData
from .confidence import FLOOR
from .groups import Units
from .networks import Fields
from .pixel_samples import residual_weight
from .projection import color_lines
from .reliability import PartDetail, PlaceColors, part_detail
from .seen import SeenCells

# Smallest and largest base colour of a pixel, whose light may be wrong.
MIN_COLOR, MAX_COLOR = -0.5, 2.0


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
        drawn: pixels of :func:`.cell_errors.draw_pixels`. data: with the last shadings.
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
