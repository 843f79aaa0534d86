# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface cells: small pieces of the room's surface, through which views are compared with each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..capture.views import View
from ..light.cache import side_index
from ..pixels.grouped import grouped_means, summed_by_key
from ..pixels.store import CELL_PIXELS, PixelStore
from ..surface.room import Room

# Radiance below this share of the capture's median is too dark to compare; it is clamped to it.
DARK = 0.02
# Most cells along the room's longest side.
MOST_CELLS = 1024
# Photographs are compared on a lattice of pixels of about this width.
REGISTERED_WIDTH = 320


@dataclass(frozen=True)
class CellPixels:
    """The lattice pixels of one view that see a single surface of the mesh.

    Attributes:
        rows: (M,) int64 pixel indices among those of all views, ascending.
        cell: (M,) int64 surface cell, from 0.
        value: (M,) float64 log of grey radiance, in units of the capture's median.
    """

    rows: np.ndarray
    cell: np.ndarray
    value: np.ndarray

    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """(m,) int64 cells of the view, ascending, and (m,) float64 mean value of each."""
        cell, place = np.unique(self.cell, return_inverse=True)
        return cell, grouped_means(self.value, place)

    def among(self, chosen: np.ndarray) -> CellPixels:
        """The pixels marked in `chosen`, (M,) bool."""
        return CellPixels(self.rows[chosen], self.cell[chosen], self.value[chosen])


@dataclass(frozen=True)
class CellGrid:
    """How surface points are sorted into cells by position, side and part.

    Attributes:
        part: (T,) int part of each triangle, negative without.
        side: (T,) int64 dominant direction of each triangle's normal.
        low: (3,) lowest corner of the room, metres.
        size: edge of a cell, metres.
    """

    part: np.ndarray
    side: np.ndarray
    low: np.ndarray
    size: float

    def keys(self, pixels: PixelStore, rows: np.ndarray) -> np.ndarray:
        """(M,) int64 key of the cell that each pixel (M,) sees; equal where the cells are."""
        place = np.floor((np.asarray(pixels.position[rows]) - self.low) / self.size).astype(np.int64) + 1
        triangle = np.asarray(pixels.triangle[rows])
        key = (place[:, 0] * (MOST_CELLS + 4) + place[:, 1]) * (MOST_CELLS + 4) + place[:, 2]
        key = key * 12 + self.side[triangle] * 2 + np.asarray(pixels.front[rows])
        return key * self._parts + self.part[triangle] + 1

    @property
    def _parts(self) -> int:
        """Number of parts with none."""
        return int(self.part.max(initial=0)) + 2


@dataclass(frozen=True)
class SurfaceCells:
    """The surface cells that the views saw.

    Only the cells are kept: their number depends on the surface. Pixels are looked up view by view with their
    current values, so that pixels left out and corrected exposures count from then on.

    Attributes:
        grid: how pixels are sorted into cells.
        keys: (count,) int64 key of each cell, ascending.
        pixel_count: number of pixels that the cells were made of.
    """

    pixels: PixelStore
    grid: CellGrid
    keys: np.ndarray
    pixel_count: int

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.keys)

    def of_view(self, index: int) -> CellPixels:
        """The pixels of a view."""
        pixels = self.pixels
        rows = lattice_hits(pixels, index)
        radiance = np.asarray(pixels.radiance[rows]).mean(axis=1, dtype=np.float64)
        cell = np.searchsorted(self.keys, self.grid.keys(pixels, rows))
        return CellPixels(rows, cell, np.log(np.maximum(radiance, DARK)))


def lattice_spacing(view: View) -> int:
    """Spacing in pixels of a view's lattice."""
    return max(1, view.width // REGISTERED_WIDTH)


def lattice(view: View) -> tuple[slice, slice]:
    """Rows and columns of a view's image that lie on its lattice."""
    step = lattice_spacing(view)
    return slice(step // 2, None, step), slice(step // 2, None, step)


def lattice_hits(pixels: PixelStore, index: int) -> np.ndarray:
    """(M,) int64 pixels on the lattice of a view that see a single surface of the mesh."""
    view, rows = pixels.views[index], pixels.rows(index)
    usable = (np.asarray(pixels.triangle[rows]) >= 0) & pixels.pure[rows]
    chosen = np.zeros((view.height, view.width), bool)
    on_lattice = lattice(view)
    chosen[on_lattice] = usable.reshape(chosen.shape)[on_lattice]
    return np.flatnonzero(chosen) + rows.start


def surface_cells(pixels: PixelStore, room: Room, part: np.ndarray, footprint: float) -> SurfaceCells:
    """Sort the pure pixels into cells by position, side and part.

    Args:
        part: (T,) int part of each triangle, negative without.
        footprint: median width of a pixel on the surfaces, metres.
    """
    low, high = room.bounds
    spacing = float(np.median([lattice_spacing(view) for view in pixels.views]))
    size = max(CELL_PIXELS * spacing * footprint, float((high - low).max()) / MOST_CELLS)
    grid = CellGrid(part, side_index(room.normals), low, size)
    views = (grid.keys(pixels, lattice_hits(pixels, index)) for index in range(len(pixels.views)))
    keys, count = summed_by_key((keys, np.ones(len(keys))) for keys in views)
    return SurfaceCells(pixels, grid, keys, int(count.sum()))
