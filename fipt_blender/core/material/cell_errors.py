"""Standard errors of the final estimate in each seen cell, from the pixels of a run and the last shadings."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..pixels.grouped import grouped_means
from ..pixels.store import PixelStore
from .closed_form import TrainingData
from .confidence import FLOOR, UNIFORM_DEVIATION, linearise, standard_errors
from .groups import Units
from .networks import Fields
from .projection import color_lines
from .seen import RESOLUTION, Box, SeenCells, cell_keys

# About so many pixels are used; more change only the time.
PIXELS = 1_500_000
# Edge, in cells, of the blocks of similar residuals outside units of one material.
BLOCK = 8
# Quantile of the errors of a group's cells that its cells without pure pixels take.
UNSAMPLED_QUANTILE = 0.9


@dataclass(frozen=True)
class DrawnPixels:
    """About `PIXELS` pure pixels, and the K cells that they see.

    Attributes:
        rows: (n,) int64 of the pixels.
        position, unit: (n, 3) metres, (n,) int of the surface.
        cells: (K,) int64 index of each cell, ascending.
        place: (n,) int64 index into `cells`.
    """

    rows: np.ndarray
    position: np.ndarray
    unit: np.ndarray
    cells: np.ndarray
    place: np.ndarray


def draw_pixels(
    pixels: PixelStore, units: Units, box: Box, cells: SeenCells, unused: np.ndarray, seed: int
) -> DrawnPixels:
    """Pure pixels at random, none of `unused` triangles ((T,) bool)."""
    rng = np.random.default_rng([seed, 5])
    probability = PIXELS / max(len(pixels), 1)
    ranges = itertools.pairwise(pixels.ranges)
    drawn = [np.flatnonzero(rng.random(end - start) < probability) + start for start, end in ranges]
    rows = np.concatenate(drawn)
    triangle = pixels.triangle[rows]
    rows = rows[(triangle >= 0) & pixels.pure[rows] & ~unused[triangle]]
    position = np.asarray(pixels.position[rows])
    unit = units.triangle[pixels.triangle[rows]]
    seen = np.searchsorted(cells.keys, cell_keys(box, position, unit))
    return DrawnPixels(rows, position, unit, *np.unique(seen, return_inverse=True))


def cell_errors(
    drawn: DrawnPixels, data: TrainingData, units: Units, fields: Fields, cells: SeenCells
) -> np.ndarray:
    """(C, 3) float32 standard errors of base colour, roughness and metallic of `fields` in the C cells.

    Args:
        data: the last shadings, and groups with their errors.
    """
    errors = np.full((len(cells.keys), 3), UNIFORM_DEVIATION, np.float32)
    rows, sampled, cell = drawn.rows, drawn.cells, drawn.place
    if not len(rows):
        return errors
    group_of_cell = groups_of_cells(units, fields, cells)
    values = fields.query(drawn.position, drawn.unit)
    of_group = np.append(data.materials.error, [[UNIFORM_DEVIATION] * 2], axis=0)
    of_pixel = np.sqrt(of_group[data.group[rows]] ** 2 + FLOOR**2).astype(np.float32)
    pixels = data.observations.pixels
    lines = partial(color_lines, data.shadings, rows)
    linearised = linearise(pixels.own[rows], lines, values[:, :3], values[:, 3:], of_pixel)
    errors[sampled, 0] = standard_errors(linearised, cell, group_of_cell[sampled[cell]], pixels.view_of(rows))
    errors[sampled, 1:] = np.minimum(grouped_means(of_pixel, cell), UNIFORM_DEVIATION)
    unsampled = np.ones(len(errors), bool)
    unsampled[sampled] = False
    for index in np.unique(group_of_cell[unsampled]):
        in_group = group_of_cell == index
        if (in_group & ~unsampled).any():
            errors[in_group & unsampled] = np.quantile(
                errors[in_group & ~unsampled], UNSAMPLED_QUANTILE, axis=0
            )
    return errors


@dataclass(frozen=True)
class LitCells:
    """The K cells that pure pixels saw.

    Attributes:
        cell: (K,) int64 index of each.
        points, normals: (K, 3) a seen point, metres, and the mean unit normal on the seen side.
        color: (K,) mean base colour.
        diffuse: (K,) mean L_d.
    """

    cell: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    color: np.ndarray
    diffuse: np.ndarray


def lit_cells(drawn: DrawnPixels, data: TrainingData, fields: Fields, cells: SeenCells) -> LitCells:
    """The cells with the light on them; arguments as of :func:`cell_errors`."""
    rows, seen = drawn.rows, drawn.cells
    normals = grouped_means(np.asarray(data.observations.pixels.normal[rows], np.float64), drawn.place)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    diffuse = grouped_means(np.asarray(data.shadings.diffuse[rows], np.float64), drawn.place).mean(axis=1)
    color = fields.query(cells.points[seen], cells.part[seen])[:, :3].mean(axis=1)
    return LitCells(seen, cells.points[seen].astype(np.float64), normals, color, diffuse)


def add_light_errors(errors: np.ndarray, lit: LitCells, light_errors: np.ndarray) -> np.ndarray:
    """Standard errors (C, 3) with what the error of the light adds to that of base colour.

    The relative error of a base colour is that of its L_d.

    Args:
        light_errors: (K,) standard errors of the L_d of `lit`.
    """
    result = errors.copy()
    relative = light_errors / np.maximum(lit.diffuse, 1e-9)
    total = np.hypot(errors[lit.cell, 0], lit.color * relative)
    result[lit.cell, 0] = np.minimum(total, UNIFORM_DEVIATION)
    return result


def groups_of_cells(units: Units, fields: Fields, cells: SeenCells) -> np.ndarray:
    """(C,) int64 group of each cell: its unit if that is of one material, else its block of cells."""
    blocks = (fields.box.normalise(cells.points) * (RESOLUTION // BLOCK)).astype(np.int64) @ (1, 64, 64**2)
    blocks = np.where(units.is_single(cells.part), 0, blocks)
    return np.unique((cells.part.astype(np.int64) + 1) * 64**3 + blocks, return_inverse=True)[1]
