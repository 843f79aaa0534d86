# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the photographs agree with each other on the mesh: exposures, and poses that do not fit.

What one view shows is predicted from what all others saw of the same surface cells. A view whose photograph
is a constant factor off was exposed otherwise; one that agrees far better after a small turn or shift of its
camera is misaligned (the paper's rejection of frames, supplementary "Geometry acquisition").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..capture.views import View
from ..scene.pixels import PixelStore
from ..scene.room import Room, triangle_normals
from .cache import side_index
from .registration import Fit, register

# Darker than this share of the capture's median says little about anything.
DARK = 0.02
# Edge of a surface cell in median pixel footprints, and most cells along the room's longest side.
CELL_PIXELS = 1.5
MOST_CELLS = 1024
# About so many pixels give the exposures.
GAIN_PIXELS = 1_000_000
# Cells that a view must share with others before its exposure is judged.
SHARED_CELLS = 30
# Exposures closer to the others' than this factor are left alone: highlights move them by as much.
SAME_EXPOSURE = 1.06
# Photographs are compared on a lattice of pixels of about this width.
REGISTERED_WIDTH = 320
# Displacement in steps of it from which a view may be misaligned, if it is this many times the median too.
LEAST_SHIFT = 1.5
UNLIKE_OTHERS = 3.0
# Registration must lower the robust residual to this share of what the given pose leaves.
CLEARLY_BETTER = 0.5
# ... and by so much: a camera may drift along faint gradients, but edges that do not meet cost more.
LEAST_GAIN = 0.06
# Log radiance by which a view may differ from the others after registration, whatever the others do.
LEAST_DIFFERENCE = 0.2
# Views of which more than this share would be left out: then not they, but the mesh is wrong.
MOST_LEFT_OUT = 1.0 / 3.0
LEAST_VIEWS = 4


@dataclass(frozen=True)
class CellPixels:
    """Pixels of one view that see one surface of the mesh, on the view's lattice.

    Attributes:
        rows: (M,) int64 pixels among those of all views; rising.
        cell: (M,) int64 surface cell, from 0.
        value: (M,) float64 log of grey radiance, in units of the capture's median.
    """

    rows: np.ndarray
    cell: np.ndarray
    value: np.ndarray

    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """(m,) int64 cells of the view, rising, and (m,) float64 mean of the values in each."""
        cell, place = np.unique(self.cell, return_inverse=True)
        place = place.reshape(-1)
        return cell, np.bincount(place, self.value) / np.maximum(np.bincount(place), 1)

    def among(self, chosen: np.ndarray) -> CellPixels:
        """Those marked, (M,) bool."""
        return CellPixels(self.rows[chosen], self.cell[chosen], self.value[chosen])


@dataclass(frozen=True)
class SurfaceCells:
    """Pieces of surface by place, side and part, and which pixels saw them.

    Only the cells are kept: their number depends on the surface. Pixels are looked up view by view, as they
    are by then: left out or brought to another exposure.

    Attributes:
        part: (T,) int part of each triangle, negative without.
        side: (T,) int64 dominant direction of each triangle's normal.
        low: (3,) lowest corner of the room, metres.
        size: edge of a cell, metres.
        keys: (count,) int64 number that place, side and part make, rising.
        seen: pixels that they were made of.
    """

    pixels: PixelStore
    part: np.ndarray
    side: np.ndarray
    low: np.ndarray
    size: float
    keys: np.ndarray
    seen: int

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.keys)

    def of_view(self, index: int) -> CellPixels:
        """The pixels of a view."""
        pixels = self.pixels
        rows = _lattice_hits(pixels, index)
        keys = _keys(pixels, rows, self.part, self.side, self.low, self.size)
        radiance = np.asarray(pixels.radiance[rows]).mean(axis=1, dtype=np.float64)
        return CellPixels(rows, np.searchsorted(self.keys, keys), np.log(np.maximum(radiance, DARK)))


def reduction(view: View) -> int:
    """Pixels of a view from one point of its lattice to the next."""
    return max(1, view.width // REGISTERED_WIDTH)


def _lattice_hits(pixels: PixelStore, index: int) -> np.ndarray:
    """(M,) int64 pixels on the lattice of a view that see one surface of the mesh."""
    view, own = pixels.views[index], pixels.rows(index)
    step = reduction(view)
    usable = (np.asarray(pixels.triangle[own]) >= 0) & pixels.pure[own]
    chosen = np.zeros((view.height, view.width), bool)
    lattice = np.s_[step // 2 :: step, step // 2 :: step]
    chosen[lattice] = usable.reshape(chosen.shape)[lattice]
    return np.flatnonzero(chosen) + own.start


def _keys(
    pixels: PixelStore, rows: np.ndarray, part: np.ndarray, side: np.ndarray, low: np.ndarray, size: float
) -> np.ndarray:
    """(M,) int64 number of the cell of each pixel; arguments as in :class:`SurfaceCells`."""
    place = np.floor((np.asarray(pixels.position[rows]) - low) / size).astype(np.int64) + 1
    triangle = np.asarray(pixels.triangle[rows])
    key = (place[:, 0] * (MOST_CELLS + 4) + place[:, 1]) * (MOST_CELLS + 4) + place[:, 2]
    key = key * 12 + side[triangle] * 2 + np.asarray(pixels.front[rows])
    return key * (int(part.max(initial=0)) + 2) + part[triangle] + 1


def surface_cells(pixels: PixelStore, room: Room, part: np.ndarray, footprint: float) -> SurfaceCells:
    """Sort the pure pixels into cells by place, side and part.

    Args:
        part: (T,) int part of each triangle, negative without.
        footprint: median width of a pixel on the surfaces, metres.
    """
    low, high = room.bounds
    spacing = float(np.median([reduction(view) for view in pixels.views]))
    size = max(CELL_PIXELS * spacing * footprint, float((high - low).max()) / MOST_CELLS)
    side = side_index(triangle_normals(room.vertices, room.triangles))
    keys = np.zeros(0, np.int64)
    waiting: list[np.ndarray] = []
    seen = number = 0
    for index in range(len(pixels.views)):
        rows = _lattice_hits(pixels, index)
        waiting.append(np.unique(_keys(pixels, rows, part, side, low, size)))
        seen += len(rows)
        number += len(waiting[-1])
        if number > len(keys) or index == len(pixels.views) - 1:  # rarer and rarer: sorting takes time
            keys = np.unique(np.concatenate([keys, *waiting]))
            waiting, number = [], 0
    return SurfaceCells(pixels, part, side, low, size, keys, seen)


def exposure_gains(cells: SurfaceCells) -> np.ndarray:
    """(views,) factor by which each photograph is brighter than the others say; 1 where nothing tells.

    Robust least squares of log radiance = surface cell + view. The median view has a factor of 1.
    """
    views = len(cells.pixels.views)
    # Of many pixels those of every so many cells: such cells are shared by as many views as all are.
    step = max(1, -(-cells.seen // GAIN_PIXELS))
    means = []
    for index in range(views):
        own = cells.of_view(index)
        means.append(own.among(own.cell % step == 0).means())
    view = np.repeat(np.arange(views), [len(of_view) for of_view, _ in means])
    cell, value = (np.concatenate(columns) for columns in zip(*means, strict=True))
    order = np.argsort(cell, kind="stable")
    cell, view, value = cell[order], view[order], value[order]
    shared = np.bincount(cell, minlength=cells.count)[cell] > 1
    cell, view, value = cell[shared], view[shared], value[shared]
    gain = np.zeros(views)
    if not len(cell):
        return np.ones(views)
    weight = np.ones(len(cell))
    for _ in range(8):
        gain = _solve_gains(cell, view, value, weight, views, cells.count, gain)
        left = value - gain[view]
        mean = np.bincount(cell, weight * left, cells.count) / np.maximum(
            np.bincount(cell, weight, cells.count), 1e-12
        )
        residual = left - mean[cell]
        scale = max(1.48 * float(np.median(np.abs(residual))), 0.01)
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
    judged = np.bincount(view, minlength=views) >= SHARED_CELLS
    if not judged.any():
        return np.ones(views)
    gain -= np.median(gain[judged])
    return np.where(judged, np.exp(gain), 1.0)


def _solve_gains(
    cell: np.ndarray,
    view: np.ndarray,
    value: np.ndarray,
    weight: np.ndarray,
    views: int,
    cells: int,
    start: np.ndarray,
) -> np.ndarray:
    """Weighted least squares for the views' log gains, the cells eliminated, by conjugate gradients."""
    total = np.maximum(np.bincount(cell, weight, cells), 1e-12)

    def apart(values: np.ndarray) -> np.ndarray:
        """(views,) weighted sums of what the cells' means leave of values."""
        mean = np.bincount(cell, weight * values, cells) / total
        return np.bincount(view, weight * (values - mean[cell]), views)

    gain = start.copy()
    residual = apart(value) - apart(gain[view])
    direction, squared = residual.copy(), float(residual @ residual)
    for _ in range(60):
        if squared < 1e-12 * max(float(weight.sum()), 1.0):
            break
        image = apart(direction[view])
        step = squared / max(float(direction @ image), 1e-30)
        gain += step * direction
        residual -= step * image
        new = float(residual @ residual)
        direction, squared = residual + (new / squared) * direction, new
    return gain


def unlike_exposures(gains: np.ndarray) -> np.ndarray:
    """(k,) indices of the views whose exposure is another than most views'."""
    return np.flatnonzero(np.abs(np.log(gains)) > np.log(SAME_EXPOSURE))


def misaligned_views(cells: SurfaceCells, gains: np.ndarray) -> dict[int, Fit]:
    """Views whose photograph does not lie where its pose says, worst first.

    Found in passes, since a misaligned view also spoils what is expected of others: each pass leaves out the
    worst and looks again. Empty where so many would be left out that the mesh itself must be wrong.

    Args:
        gains: (views,) exposure of each view; 1 for the usual one.
    """
    views = cells.pixels.views
    found: dict[int, Fit] = {}
    judged = [index for index in range(len(views)) if len(_lattice_hits(cells.pixels, index))]
    if len(judged) < LEAST_VIEWS:
        return {}
    while True:
        kept = [index for index in judged if index not in found]
        told = _Told(cells, gains, kept)
        bad = _worst({index: told.fit(index) for index in kept}, [reduction(view) for view in views])
        if not bad:
            break
        found |= bad
        if len(found) > MOST_LEFT_OUT * len(judged):
            return {}
    return found


class _Told:
    """What views saw of the cells, against which each of them is registered.

    Args:
        gains: (views,) exposure of each view.
        kept: indices of the views that tell.
    """

    def __init__(self, cells: SurfaceCells, gains: np.ndarray, kept: Sequence[int]) -> None:
        self._cells, self._log_gains = cells, np.log(gains)
        self._sums, self._number = np.zeros(cells.count), np.zeros(cells.count, np.int64)
        for index in kept:
            own = cells.of_view(index)
            np.add.at(self._sums, own.cell, own.value - self._log_gains[index])
            np.add.at(self._number, own.cell, 1)

    def fit(self, index: int) -> Fit:
        """Register one view, which is among those that tell, against what the others saw."""
        own, view = self._cells.of_view(index), self._cells.pixels.views[index]
        value = own.value - self._log_gains[index]
        place = np.unique(own.cell, return_inverse=True)[1].reshape(-1)
        others = self._number[own.cell] - np.bincount(place)[place]
        expected = (self._sums[own.cell] - np.bincount(place, value)[place]) / np.maximum(others, 1)
        images = np.zeros((3, view.height * view.width))
        images[:, own.rows - int(self._cells.pixels.ranges[index])] = value, expected, others > 0
        step = reduction(view)
        lattice = images.reshape(3, view.height, view.width)[:, step // 2 :: step, step // 2 :: step]
        shown, told, known = lattice
        fit = register(shown, told, known > 0.0, view.intrinsics / step)
        return replace(fit, shift=fit.shift * step)


def _worst(fits: dict[int, Fit], steps: list[int]) -> dict[int, Fit]:
    """Views that do not fit; of those only the ones at least half as bad as the worst.

    Args:
        steps: of the lattice of each view, in pixels.
    """
    shifts = [fit.shift / steps[index] for index, fit in fits.items()]
    differences = [fit.difference for fit in fits.values()]
    most_shift = max(LEAST_SHIFT, UNLIKE_OTHERS * float(np.median(shifts)))
    most_difference = max(LEAST_DIFFERENCE, UNLIKE_OTHERS * float(np.median(differences)))
    badness: dict[int, float] = {}
    for index, fit in fits.items():
        shift = fit.shift / steps[index]
        better = fit.improvement < CLEARLY_BETTER and fit.gain > LEAST_GAIN
        if shift > most_shift and better:
            badness[index] = shift / most_shift
        if fit.difference > most_difference:
            badness[index] = max(badness.get(index, 0.0), fit.difference / most_difference)
    limit = 0.5 * max(badness.values(), default=0.0)
    order = sorted(badness, key=lambda index: -badness[index])
    return {index: fits[index] for index in order if badness[index] >= limit}


def describe(views: Sequence[View], values: dict[int, str], most: int = 8) -> str:
    """Names of views, each with a remark, for a message; long lists are cut."""
    listed = [f"{views[index].name} ({text})" for index, text in list(values.items())[:most]]
    if len(values) > most:
        listed.append(f"and {len(values) - most} more")
    return ", ".join(listed)
