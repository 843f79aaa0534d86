# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Relative exposures of the photographs, from the surface cells that several views saw."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from .cells import SurfaceCells

# Exposures are estimated from about this many pixels.
GAIN_PIXELS = 1_000_000
# Cells that a view must share with others before its exposure is judged.
SHARED_CELLS = 30
# Exposures that differ by less than this factor are not corrected: highlights cause differences of this size.
SAME_EXPOSURE = 1.06


def exposure_gains(cells: SurfaceCells, without: Collection[int] = ()) -> np.ndarray:
    """(views,) factor by which each photograph is brighter than the others; 1 where that can't be judged.

    Robust least squares of log radiance = surface cell + view. The median view has a factor of 1.

    Args:
        without: indices of views that are not asked, because they do not show what their poses say.
    """
    views = len(cells.pixels.views)
    # Cells are thinned out rather than pixels, so that each cell keeps all views that share it.
    step = max(1, -(-cells.pixel_count // GAIN_PIXELS))
    means = []
    for index in range(views):
        in_view = cells.of_view(index)
        asked = (in_view.cell % step == 0) & (index not in without)
        means.append(in_view.among(asked).means())
    view = np.repeat(np.arange(views), [len(of_view) for of_view, _ in means])
    cell, value = (np.concatenate(columns) for columns in zip(*means, strict=True))
    order = np.argsort(cell, kind="stable")
    cell, view, value = cell[order], view[order], value[order]
    shared = np.bincount(cell, minlength=cells.count)[cell] > 1
    cell, view, value = cell[shared], view[shared], value[shared]
    judged = np.bincount(view, minlength=views) >= SHARED_CELLS
    if not judged.any():
        return np.ones(views)
    samples = _GainSamples(cell, view, value, np.ones(len(cell)), cells.count, views)
    gain = np.zeros(views)
    for _ in range(8):
        gain = samples.solve(gain)
        residual = samples.without_cells(value - gain[view])
        scale = max(1.48 * float(np.median(np.abs(residual))), 0.01)
        samples = replace(samples, weight=1.0 / (1.0 + (residual / (2.0 * scale)) ** 2))
    gain -= np.median(gain[judged])
    return np.where(judged, np.exp(gain), 1.0)


@dataclass(frozen=True)
class _GainSamples:
    """Log radiance of the cells that several views share: K samples, one for each cell and view.

    Attributes:
        cell: (K,) int64.
        view: (K,) int64.
        value: (K,) float64 log radiance.
        weight: (K,) float64.
        cells: number of all cells.
        views: number of all views.
    """

    cell: np.ndarray
    view: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    cells: int
    views: int

    @cached_property
    def _cell_weight(self) -> np.ndarray:
        """(cells,)"""
        return np.maximum(np.bincount(self.cell, self.weight, self.cells), 1e-12)

    def without_cells(self, values: np.ndarray) -> np.ndarray:
        """(K,) values minus the weighted mean of their cell."""
        mean = np.bincount(self.cell, self.weight * values, self.cells) / self._cell_weight
        return values - mean[self.cell]

    def solve(self, start: np.ndarray) -> np.ndarray:
        """(views,) log gains of the views by weighted least squares, with the cells eliminated.

        Args:
            start: (views,) gains to start from; only differences are determined, the offset is that of these.
        """

        def view_sums(values: np.ndarray) -> np.ndarray:
            return np.bincount(self.view, self.weight * self.without_cells(values), self.views)

        normal = LinearOperator((self.views,) * 2, lambda gain: view_sums(gain[self.view]), dtype=np.float64)
        tolerance = 1e-6 * max(float(self.weight.sum()), 1.0) ** 0.5
        return cg(normal, view_sums(self.value), start, rtol=0.0, atol=tolerance, maxiter=60)[0]


def unlike_exposures(gains: np.ndarray) -> np.ndarray:
    """(k,) indices of the views whose exposure differs from that of most views."""
    return np.flatnonzero(np.abs(np.log(gains)) > np.log(SAME_EXPOSURE))
