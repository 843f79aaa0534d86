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
class SurfaceCells:
    """Which pixels saw the same piece of surface.

    Attributes:
        rows: (M,) int64 pixels that see one surface of the mesh, on a lattice in each view; rising.
        cell: (M,) int64 from 0.
        view: (M,) int32 index of their view; rising.
        value: (M,) float64 log of grey radiance, in units of the capture's median.
        count: number of cells.
    """

    rows: np.ndarray
    cell: np.ndarray
    view: np.ndarray
    value: np.ndarray
    count: int

    def of_view(self, view: int) -> slice:
        """The pixels of a view."""
        return slice(*(int(place) for place in np.searchsorted(self.view, [view, view + 1])))


def reduction(view: View) -> int:
    """Pixels of a view from one point of its lattice to the next."""
    return max(1, view.width // REGISTERED_WIDTH)


def _lattice(view: View) -> np.ndarray:
    """(m,) int64 pixels of a view that lie on its lattice."""
    step = reduction(view)
    own = np.arange(view.height * view.width).reshape(view.height, view.width)
    return own[step // 2 :: step, step // 2 :: step].reshape(-1)


def surface_cells(pixels: PixelStore, room: Room, part: np.ndarray, footprint: float) -> SurfaceCells:
    """Sort the pure pixels into cells by place, side and part.

    Args:
        part: (T,) int part of each triangle, negative without.
        footprint: median width of a pixel on the surfaces, metres.
    """
    low, high = room.bounds
    spacing = float(np.median([reduction(view) for view in pixels.views]))
    size = max(CELL_PIXELS * spacing * footprint, float((high - low).max()) / MOST_CELLS)
    sides = side_index(triangle_normals(room.vertices, room.triangles))
    parts = int(part.max(initial=0)) + 2
    found, keys, values = [], [], []
    for index, view in enumerate(pixels.views):
        rows = _lattice(view) + pixels.ranges[index]
        rows = rows[(pixels.triangle[rows] >= 0) & pixels.pure[rows]]
        place = np.floor((np.asarray(pixels.position[rows]) - low) / size).astype(np.int64) + 1
        triangle = np.asarray(pixels.triangle[rows])
        side = sides[triangle] * 2 + np.asarray(pixels.front[rows])
        key = (place[:, 0] * (MOST_CELLS + 4) + place[:, 1]) * (MOST_CELLS + 4) + place[:, 2]
        keys.append((key * 12 + side) * parts + part[triangle] + 1)
        radiance = np.asarray(pixels.radiance[rows]).mean(axis=1, dtype=np.float64)
        values.append(np.log(np.maximum(radiance, DARK)))
        found.append(rows)
    unique, cell = np.unique(np.concatenate(keys), return_inverse=True)
    view_of = np.repeat(np.arange(len(found), dtype=np.int32), [len(rows) for rows in found])
    return SurfaceCells(np.concatenate(found), cell.reshape(-1), view_of, np.concatenate(values), len(unique))


def exposure_gains(cells: SurfaceCells, views: int) -> np.ndarray:
    """(views,) factor by which each photograph is brighter than the others say; 1 where nothing tells.

    Robust least squares of log radiance = surface cell + view. The median view has a factor of 1.
    """
    step = max(1, len(cells.cell) // GAIN_PIXELS)
    pair, number = np.unique(cells.cell[::step] * views + cells.view[::step], return_inverse=True)
    number = number.reshape(-1)
    value = np.bincount(number, cells.value[::step]) / np.maximum(np.bincount(number), 1)
    cell, view = pair // views, pair % views
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


def misaligned_views(pixels: PixelStore, cells: SurfaceCells, gains: np.ndarray) -> dict[int, Fit]:
    """Views whose photograph does not lie where its pose says, worst first.

    Found in passes, since a misaligned view also spoils what is expected of others: each pass leaves out the
    worst and looks again. Empty where so many would be left out that the mesh itself must be wrong.

    Args:
        gains: (views,) exposure of each view; 1 for the usual one.
    """
    found: dict[int, Fit] = {}
    judged = np.unique(cells.view).tolist()
    if len(judged) < LEAST_VIEWS:
        return {}
    value = cells.value - np.log(gains)[cells.view]
    while True:
        kept = ~np.isin(cells.view, list(found))
        sums = np.bincount(cells.cell[kept], value[kept], cells.count)
        number = np.bincount(cells.cell[kept], minlength=cells.count)
        fits = {
            i: _fit_view(pixels.views[i], int(pixels.ranges[i]), cells, value, sums, number, i)
            for i in judged
            if i not in found
        }
        bad = _worst(fits, [reduction(view) for view in pixels.views])
        if not bad:
            break
        found |= bad
        if len(found) > MOST_LEFT_OUT * len(judged):
            return {}
    return found


def _fit_view(
    view: View,
    first: int,
    cells: SurfaceCells,
    value: np.ndarray,
    sums: np.ndarray,
    number: np.ndarray,
    index: int,
) -> Fit:
    """Register one view against what the others saw."""
    own = cells.of_view(index)
    cell = cells.cell[own]
    mine = np.bincount(cell, minlength=cells.count)
    mine_sum = np.bincount(cell, value[own], cells.count)
    others = number[cell] - mine[cell]
    expected = (sums[cell] - mine_sum[cell]) / np.maximum(others, 1)
    pixel = cells.rows[own] - first
    images = np.zeros((3, view.height * view.width))
    images[:, pixel] = value[own], expected, others > 0
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
