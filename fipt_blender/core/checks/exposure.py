# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Relative exposures of the photographs, from the surface cells that several views saw."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.sparse import csr_array

from ..capture.views import photographs_of
from ..robust import deviation, without_means
from .cells import SurfaceCells

# Exposures are estimated from about this many pixels.
GAIN_PIXELS = 1_000_000
# Cells that a view must share with others before its exposure is judged.
SHARED_CELLS = 30
# Exposures that differ by less than this factor are not corrected: highlights cause differences of this size.
SAME_EXPOSURE = 1.06
# Least standard deviation of the logarithm of a cell's radiance in a view.
LEAST_SPREAD = 0.01


def exposure_gains(cells: SurfaceCells, without: Collection[int] = ()) -> np.ndarray:
    """(views,) factor by which each photograph is brighter than the others; 1 where that can't be judged.

    Robust least squares of log radiance = surface cell + photograph, of which a panorama is one. The median
    photograph has a factor of 1.

    Args:
        without: indices of views that are ignored, because their poses are wrong.
    """
    photograph = photographs_of(cells.pixels.views)
    # Cells are thinned out rather than pixels, so that each cell keeps all views that share it.
    step = max(1, -(-cells.pixel_count // GAIN_PIXELS))
    means = []
    for index in range(len(photograph)):
        in_view = cells.of_view(index)
        asked = (in_view.cell % step == 0) & (index not in without)
        means.append(in_view.among(asked).means())
    view = np.repeat(photograph, [len(of_view) for of_view, _ in means])
    cell, value = (np.concatenate(columns) for columns in zip(*means, strict=True))
    shared = np.bincount(cell, minlength=cells.count)[cell] > 1
    cell, view, value = cell[shared], view[shared], value[shared]
    count = int(photograph.max()) + 1
    judged = np.bincount(view, minlength=count) >= SHARED_CELLS
    if not judged.any():
        return np.ones(len(photograph))
    weight, gain = np.ones(len(cell)), np.zeros(count)
    for _ in range(8):
        gain = _solved(cell, view, value, weight, count)
        residual = without_means(value - gain[view], cell, weight)
        weight = 1.0 / (1.0 + (residual / (2.0 * deviation(residual, LEAST_SPREAD))) ** 2)
    gain -= np.median(gain[judged])
    return np.where(judged, np.exp(gain), 1.0)[photograph]


def _solved(
    cell: np.ndarray, view: np.ndarray, value: np.ndarray, weight: np.ndarray, views: int
) -> np.ndarray:
    """(views,) log gains by weighted least squares, with the cells eliminated.

    Only their differences are determined: of all solutions the smallest is taken.

    Args:
        cell, view: (K,) int. value: (K,) log radiance. weight: (K,).
    """
    shares = csr_array((weight, (cell, view)), shape=(int(cell.max()) + 1, views))
    total = np.maximum(np.bincount(cell, weight), 1e-12)
    normal = np.diag(np.bincount(view, weight, views)) - (shares.T @ (shares / total[:, None])).toarray()
    right = np.bincount(view, weight * without_means(value, cell, weight), views)
    return np.linalg.lstsq(normal, right, rcond=1e-12)[0]


def unlike_exposures(gains: np.ndarray) -> np.ndarray:
    """(k,) indices of the views whose exposure differs from that of most views."""
    return np.flatnonzero(np.abs(np.log(gains)) > np.log(SAME_EXPOSURE))
