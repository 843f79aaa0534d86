# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Misaligned views (the paper's rejection of frames, supplementary "Geometry acquisition").

What one view shows is predicted from what all other views saw of the same surface cells. A view whose
photograph agrees far better with the prediction after a small rotation of its camera is misaligned.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ..run.threads import in_threads
from .cells import SurfaceCells, lattice, lattice_hits, lattice_spacing
from .consensus import JUDGED_VIEWS, disagreement
from .registration import Fit, register

# A view may be misaligned if its displacement is at least this many lattice steps, and this many times the
# median of all views.
LEAST_SHIFT = 1.5
UNLIKE_OTHERS = 3.0
# Registration must lower the robust residual to this share of the residual at the given pose, ...
CLEARLY_BETTER = 0.5
# ... and by at least this much: a camera may drift along faint gradients, but misaligned edges cost more.
LEAST_GAIN = 0.06
# A view whose log radiance differs by less than this after registration is never rejected for it.
LEAST_DIFFERENCE = 0.2
# If registration finds more than this share of the views misaligned, besides those that are far off, it is
# undecided which of them are right.
MOST_LEFT_OUT = 1.0 / 3.0
# The fit of a view that no small rotation aligns.
FAR_OFF = Fit(shift=np.inf, improvement=1.0, gain=0.0, difference=np.inf)


def misaligned_views(
    cells: SurfaceCells, gains: np.ndarray, far_off: Collection[int] = (), force: bool = False
) -> dict[int, Fit]:
    """Views whose photograph does not agree with their pose, worst first.

    Found in passes, since a misaligned view also spoils the prediction of others: each pass leaves out the
    worst and repeats. Empty where too many would be left out, if `force` is set.

    Args:
        gains: (views,) exposure of each view; 1 for the usual one.
        far_off: views that are known to be misaligned (:mod:`.consensus`); predictions are made without them.
        force: whether captures of which most views contradict each other are accepted.

    Raises:
        FiptError: ``views-disagree``.
    """
    views = cells.pixels.views
    spacings = [lattice_spacing(view) for view in views]
    misaligned: dict[int, Fit] = {index: FAR_OFF for index in far_off}
    judged = [index for index in range(len(views)) if len(lattice_hits(cells.pixels, index))]
    if len(judged) < JUDGED_VIEWS:
        return {}
    while True:
        kept = [index for index in judged if index not in misaligned]
        prediction = _Prediction(cells, gains, kept)
        worst = _worst(dict(zip(kept, in_threads(prediction.fit, kept), strict=True)), spacings)
        if not worst:
            break
        misaligned |= worst
        by_few = len(misaligned) - len(far_off)
        if by_few > MOST_LEFT_OUT * (len(judged) - len(far_off)):
            if force:
                return {}
            raise disagreement(len(misaligned), len(judged))
    return misaligned


class _Prediction:
    """What the views saw of the cells, against which each of them is registered.

    Args:
        gains: (views,) exposure of each view.
        kept: indices of the views that the prediction is made of.
    """

    def __init__(self, cells: SurfaceCells, gains: np.ndarray, kept: Sequence[int]) -> None:
        self._cells, self._log_gains = cells, np.log(gains)
        self._sums, self._counts = np.zeros(cells.count), np.zeros(cells.count, np.int64)
        for index in kept:
            in_view = cells.of_view(index)
            np.add.at(self._sums, in_view.cell, in_view.value - self._log_gains[index])
            np.add.at(self._counts, in_view.cell, 1)

    def fit(self, index: int) -> Fit:
        """Register one of these views against what the others saw."""
        in_view, view = self._cells.of_view(index), self._cells.pixels.views[index]
        value = in_view.value - self._log_gains[index]
        place = np.unique(in_view.cell, return_inverse=True)[1].reshape(-1)
        others = self._counts[in_view.cell] - np.bincount(place)[place]
        predicted = (self._sums[in_view.cell] - np.bincount(place, value)[place]) / np.maximum(others, 1)
        images = np.zeros((3, view.height * view.width))
        images[:, in_view.rows - int(self._cells.pixels.ranges[index])] = value, predicted, others > 0
        step = lattice_spacing(view)
        photograph, prediction, known = images.reshape(3, view.height, view.width)[:, *lattice(view)]
        fit = register(photograph, prediction, known > 0.0, view.intrinsics / step)
        return replace(fit, shift=fit.shift * step)


def _worst(fits: dict[int, Fit], spacings: list[int]) -> dict[int, Fit]:
    """Views that do not fit; of those only the ones at least half as bad as the worst.

    Args:
        spacings: of each view's lattice, in pixels.
    """
    shifts = [fit.shift / spacings[index] for index, fit in fits.items()]
    differences = [fit.difference for fit in fits.values()]
    most_shift = max(LEAST_SHIFT, UNLIKE_OTHERS * float(np.median(shifts)))
    most_difference = max(LEAST_DIFFERENCE, UNLIKE_OTHERS * float(np.median(differences)))
    badness: dict[int, float] = {}
    for index, fit in fits.items():
        shift = fit.shift / spacings[index]
        better = fit.improvement < CLEARLY_BETTER and fit.gain > LEAST_GAIN
        if shift > most_shift and better:
            badness[index] = shift / most_shift
        if fit.difference > most_difference:
            badness[index] = max(badness.get(index, 0.0), fit.difference / most_difference)
    limit = 0.5 * max(badness.values(), default=0.0)
    order = sorted(badness, key=lambda index: -badness[index])
    return {index: fits[index] for index in order if badness[index] >= limit}
