# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the last shadings tell of a finished estimate: how well each seen cell is known, and lamps' pixels."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ..light.reflecting import LampPixels
from ..light.views import ShadingStore
from ..material.confidence import UNKNOWN, Evidence, evidence, standard_errors
from ..material.fields import Fields
from ..material.groups import Units
from ..material.seen import RESOLUTION, Box, SeenCells, cell_keys, seen_cells
from ..scene.pixels import PixelStore

# Pixels that are looked at; more change nothing but the time.
PIXELS = 1_500_000
# Pixels of all lamps that are looked at, and of each triangle of a lamp at least.
LAMP_PIXELS = 200_000
LEAST_LAMP_PIXELS = 100
CHUNK = 1 << 16
# Cells along the edge of a block that shares roughness and metallic where no unit of one material does.
BLOCK = 8


def find_cells(pixels: PixelStore, units: Units, box: Box) -> SeenCells:
    """Where pixels saw which unit of the room."""

    def pieces() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for first, last in itertools.pairwise(pixels.ranges):
            triangle = np.asarray(pixels.triangle[first:last])
            hit = triangle >= 0
            yield np.asarray(pixels.position[first:last])[hit], units.triangle[triangle[hit]]

    return seen_cells(box, pieces())


def cell_errors(
    pixels: PixelStore,
    units: Units,
    shadings: ShadingStore,
    levels: np.ndarray,
    fields: Fields,
    cells: SeenCells,
    emitting: np.ndarray,
    seed: int,
) -> np.ndarray:
    """(K, 3) float32 standard errors of base colour, roughness and metallic of `fields` in the cells.

    Args:
        shadings: of all pixels at the roughness `levels`.
        emitting: (T,) bool; what these reflect was not looked at.
    """
    box = fields.box
    rng = np.random.default_rng([seed, 5])
    rows = np.concatenate([_usable(pixels, view, emitting, rng) for view in range(len(pixels.views))])
    errors = np.full((len(cells.keys), 3), UNKNOWN, np.float32)
    if not len(rows):
        return errors
    part = units.triangle[pixels.triangle[rows]]
    position = np.asarray(pixels.position[rows])
    place = np.searchsorted(cells.keys, cell_keys(box, position, part))
    found, cell = np.unique(place, return_inverse=True)
    blocks = (box.normalise(cells.points) * (RESOLUTION // BLOCK)).astype(np.int64) @ (1, 64, 64**2)
    blocks = np.where(units.is_single(cells.part), 0, blocks)
    group_of_cell = np.unique((cells.part + 1) * 64**3 + blocks, return_inverse=True)[1]
    color, roughness, metallic = fields.query(position)
    pieces = []
    for start in range(0, len(rows), CHUNK):
        some, own = rows[start : start + CHUNK], slice(start, start + CHUNK)
        radiance = np.asarray(pixels.radiance[some], np.float32)
        diffuse, specular = np.asarray(shadings.diffuse[some]), np.asarray(shadings.specular[some])
        estimate = color[own], roughness[own], metallic[own]
        pieces.append(evidence(radiance, *estimate, diffuse.astype(np.float32), specular, levels))
    whole = Evidence(*(np.concatenate([vars(each)[name] for each in pieces]) for name in vars(pieces[0])))
    group = group_of_cell[place]
    by_cell, *by_group = standard_errors(whole, roughness, metallic, cell, group, pixels.view_of(rows))
    errors[found, 0] = by_cell
    seen_groups = np.unique(group)
    for column, values in enumerate(by_group, start=1):
        known = np.full(group_of_cell.max() + 1, UNKNOWN)
        known[seen_groups] = values[seen_groups]
        errors[:, column] = known[group_of_cell]
    # Cells of which no pixel saw one surface alone are about as sure as the worse ones of their part.
    rest = np.ones(len(errors), bool)
    rest[found] = False
    for name in np.unique(group_of_cell[rest]):
        mine = group_of_cell == name
        if (mine & ~rest).any():
            errors[mine & rest, 0] = np.quantile(errors[mine & ~rest, 0], 0.9)
    return errors


def _usable(pixels: PixelStore, view: int, emitting: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pixels of a view that see one surface alone that does not shine, thinned out to the view's share."""
    first, last = (int(each) for each in pixels.ranges[view : view + 2])
    usable = _on(pixels, first, last, ~emitting)
    usable &= rng.random(last - first) < PIXELS / max(len(pixels), 1)
    return first + np.flatnonzero(usable)


def lamp_pixels(pixels: PixelStore, shadings: ShadingStore, emitting: np.ndarray, seed: int) -> LampPixels:
    """The pixels that see the triangles `emitting` ((T,) bool) alone; of many that see one, some."""
    views = range(len(pixels.views))

    def seeing(index: int) -> np.ndarray:
        first, last = (int(each) for each in pixels.ranges[index : index + 2])
        return first + np.flatnonzero(_on(pixels, first, last, emitting))

    count = np.zeros(len(emitting), np.int64)
    for index in views:
        np.add.at(count, pixels.triangle[seeing(index)], 1)
    most = max(LAMP_PIXELS // max(int(emitting.sum()), 1), LEAST_LAMP_PIXELS)
    share = most / np.maximum(count, 1)
    rng = np.random.default_rng([seed, 7])
    found = [np.zeros(0, np.int64)]
    for index in views:
        rows = seeing(index)
        found.append(rows[rng.random(len(rows)) < share[pixels.triangle[rows]]])
    rows = np.concatenate(found)
    return LampPixels(
        triangle=np.asarray(pixels.triangle[rows]),
        front=np.asarray(pixels.front[rows]),
        view=pixels.view_of(rows),
        radiance=np.asarray(pixels.radiance[rows], np.float64),
        diffuse=np.asarray(shadings.diffuse[rows], np.float64),
        specular=np.asarray(shadings.specular[rows, -1], np.float64),
    )


def _on(pixels: PixelStore, first: int, last: int, marked: np.ndarray) -> np.ndarray:
    """(last - first,) bool, pixels that see marked triangles ((T,) bool) and nothing else."""
    triangle = np.asarray(pixels.triangle[first:last])
    return (triangle >= 0) & np.asarray(pixels.pure[first:last]) & marked[np.maximum(triangle, 0)]
