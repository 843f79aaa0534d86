"""Misaligned views (the paper's rejection of frames, supplementary "Geometry acquisition").

What one view shows is predicted from what all other views saw of the same surface cells. Registration finds
the small rotation of its camera by which both agree best, by Gauss-Newton from coarse to fine. A view that
agrees far better after it is misaligned.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from ..robust import gauss_newton, without_means
from ..run.threads import in_threads
from .consensus import JUDGED_VIEWS, disagreement
from .consistency import ConsistencyTable, lattice, lattice_hits, lattice_spacing

# Standard deviations in pixels of the blurs at which the images are compared, from coarse to fine.
BLURS = (6.0, 3.0, 1.5)
# Gauss-Newton steps at each blur.
STEPS = 6
# Residuals of log radiance well above this are outliers (highlights, edges, people).
STRAY = 0.15
# Standard deviation in pixels of the prior on displacements: plain walls must not drift along their noise.
EXPECTED_SHIFT = 2.0
LEAST_PIXELS = 200
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


@dataclass(frozen=True)
class Fit:
    """How well a photograph agrees with its camera pose.

    Attributes:
        shift: root mean square of the displacement that registration finds, in pixels.
        improvement: robust residual after registration divided by that before; 1 where nothing is gained.
        gain: robust residual (mean of log(1 + (r / STRAY)^2)) before registration minus that after it.
        difference: median absolute difference of log radiance after registration.
    """

    shift: float
    improvement: float
    gain: float
    difference: float


# The fit of a photograph that shares too few pixels with the prediction.
NO_VERDICT = Fit(shift=0.0, improvement=1.0, gain=0.0, difference=0.0)
# The fit of a view that no small rotation aligns.
FAR_OFF = Fit(shift=np.inf, improvement=1.0, gain=0.0, difference=np.inf)


def misaligned_views(
    table: ConsistencyTable, gains: np.ndarray, far_off: Collection[int] = (), force: bool = False
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
    views = table.pixels.views
    spacings = [lattice_spacing(view) for view in views]
    misaligned: dict[int, Fit] = {index: FAR_OFF for index in far_off}
    judged = [index for index in range(len(views)) if len(lattice_hits(table.pixels, index))]
    if len(judged) < JUDGED_VIEWS:
        return {}
    while True:
        kept = [index for index in judged if index not in misaligned]
        worst = _worst(register_views(table, np.log(gains), kept), spacings)
        if not worst:
            break
        misaligned |= worst
        by_few = len(misaligned) - len(far_off)
        if by_few > MOST_LEFT_OUT * (len(judged) - len(far_off)):
            if force:
                return {}
            raise disagreement(len(misaligned), len(judged))
    return misaligned


def register_views(table: ConsistencyTable, log_gains: np.ndarray, kept: Sequence[int]) -> dict[int, Fit]:
    """How well each of some views agrees with what the others of them saw of the same cells.

    Args:
        table: of grey values.
        log_gains: (V,) logarithm of each view's exposure.
        kept: indices of the views.
    """
    sums, counts = np.zeros(len(table.keys)), np.zeros(len(table.keys), np.int64)
    for index in kept:
        _, cell, value = table.of_view(index)
        np.add.at(sums, cell, value[:, 0] - log_gains[index])
        np.add.at(counts, cell, 1)

    def fit(index: int) -> Fit:
        rows, cell, value = table.of_view(index)
        view, value = table.pixels.views[index], value[:, 0] - log_gains[index]
        place = np.unique(cell, return_inverse=True)[1].reshape(-1)
        others = counts[cell] - np.bincount(place)[place]
        predicted = (sums[cell] - np.bincount(place, value)[place]) / np.maximum(others, 1)
        images = np.zeros((3, view.height * view.width))
        images[:, rows - int(table.pixels.ranges[index])] = value, predicted, others > 0
        step = lattice_spacing(view)
        photograph, prediction, known = images.reshape(3, view.height, view.width)[:, *lattice(view)]
        found = register(photograph, prediction, known > 0.0, view.intrinsics / step)
        return replace(found, shift=found.shift * step)

    return dict(zip(kept, in_threads(fit, kept), strict=True))


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


def register(
    photograph: np.ndarray,
    predicted: np.ndarray,
    known: np.ndarray,
    intrinsics: np.ndarray,
) -> Fit:
    """Find the camera's rotation by which the photograph agrees best with the prediction.

    A camera at a wrong position is found too: apart from parallax, its error looks like a rotation.

    Args:
        photograph: (H, W) log radiance of the photograph.
        predicted: (H, W) log radiance that the other views predict.
        known: (H, W) bool, where both are known.
        intrinsics: (3, 3) in pixels of these images.
    """
    if known.sum() < LEAST_PIXELS:
        return NO_VERDICT
    grid = np.stack(np.meshgrid(*(np.arange(count) + 0.5 for count in known.shape[::-1])), axis=-1)
    flow = turn_flow(grid.reshape(-1, 2), intrinsics)
    size = np.sqrt((flow**2).sum(axis=1).mean(axis=0))
    rotation = np.zeros(3)
    for blur in BLURS:
        blurred = _blurred(photograph, known, blur)
        images = np.stack([blurred, *np.gradient(blurred)[::-1]])
        pair = _Pair(images, _blurred(predicted, known, blur)[known], known, flow[known.reshape(-1)])
        # Precision of the prior per squared radian. Blur correlates the residuals of 4 pi blur^2 pixels.
        system = partial(pair.system, 4.0 * np.pi * blur**2 * (size / EXPECTED_SHIFT) ** 2)
        rotation = gauss_newton(system, rotation, 0.0, most_steps=STEPS, longest=np.inf, settled=0.0).x
    # Both are judged at the last blur, the finest.
    given, registered = pair.cost(np.zeros(3)), pair.cost(rotation)
    if given is None:
        return NO_VERDICT
    if registered is None:  # the rotation moves the photograph off the known pixels
        rotation, registered = np.zeros(3), given
    (before, _), (after, difference) = given, registered
    shift = float(np.sqrt((pair.displacement(rotation) ** 2).sum(axis=0).mean()))
    return Fit(shift, min(after / max(before, 1e-12), 1.0), before - after, difference)


def turn_flow(pixel: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """(K, 2, 3) displacement x, y of pixels (K, 2) per radian of rotation about each axis of the camera."""
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    x, y = ((pixel - intrinsics[:2, 2]) / (fx, fy)).T
    flow_x, flow_y = (-x * y, 1.0 + x**2, -y), (-(1.0 + y**2), x * y, x)
    return np.stack([fx * np.stack(flow_x, axis=1), fy * np.stack(flow_y, axis=1)], axis=1)


def _blurred(image: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """The (H, W) image blurred over its known pixels."""
    radius = int(3.0 * sigma) + 1
    total, weight = (
        gaussian_filter(values, sigma, mode="constant", radius=radius)
        for values in (image * known, known.astype(np.float64))
    )
    return total / np.maximum(weight, 1e-12)


@dataclass(frozen=True)
class _Pair:
    """A photograph and its prediction at one blur.

    Attributes:
        photograph: (3, H, W) log radiance and its gradients along x and y.
        predicted: (M,) log radiance at the known pixels, row by row.
        known: (H, W) bool, true at M pixels.
        flow: (M, 2, 3) displacement of these pixels, as of :func:`turn_flow`.
    """

    photograph: np.ndarray
    predicted: np.ndarray
    known: np.ndarray
    flow: np.ndarray

    def displacement(self, rotation: np.ndarray) -> np.ndarray:
        """(2, M) displacement (x, y) in pixels by a small rotation (3,)."""
        return (self.flow @ rotation).T

    def residuals(self, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compare the prediction with the photograph seen by a rotated camera, bilinearly interpolated.

        Returns:
            (K,) residuals of log radiance at the pixels where both are known, (2, K) gradients of the
            photograph there, and (M,) bool, which of the known pixels these are.
        """
        height, width = self.known.shape
        row, column = np.nonzero(self.known)
        shift = self.displacement(rotation)
        x, y = column + shift[0], row + shift[1]
        usable = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        # All four pixels around the position must be known.
        left = np.clip(x, 0, width - 2).astype(np.int64)
        top = np.clip(y, 0, height - 2).astype(np.int64)
        across = self.known[:, :-1] & self.known[:, 1:]
        usable &= (across[:-1] & across[1:])[top, left]
        positions = np.stack([y[usable], x[usable]])
        values, *gradients = (map_coordinates(image, positions, order=1) for image in self.photograph)
        return self.predicted[usable] - values, np.stack(gradients), usable

    def system(
        self, pull: np.ndarray, rotation: np.ndarray, _: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Normal matrix (3, 3), right side (3,) and noise for a step; a factor of exposure is eliminated.

        Args:
            pull: (3,) weight of the prior, for residuals of 1.
        """
        residual, gradient, usable = self.residuals(rotation)
        if len(residual) < LEAST_PIXELS:
            return np.eye(3), np.zeros(3), 0.0
        residual -= np.median(residual)
        weight = 1.0 / (1.0 + (residual / STRAY) ** 2)
        rows = np.einsum("am,mak->mk", gradient, self.flow[usable])
        rows = without_means(rows, np.zeros(len(rows), np.int64), weight)
        noise = float(np.average(residual**2, weights=weight)) + 1e-6
        normal = rows.T @ (rows * weight[:, None]) + np.diag(noise * pull + 1e-9)
        return normal, rows.T @ (weight * residual) - noise * pull * rotation, noise

    def cost(self, rotation: np.ndarray) -> tuple[float, float] | None:
        """Mean robust residual at a rotation, and the median absolute residual; None with too few pixels."""
        residual, _, _ = self.residuals(rotation)
        if len(residual) < LEAST_PIXELS:
            return None
        difference = float(np.median(np.abs(residual)))
        residual -= np.median(residual)
        return float(np.log1p((residual / STRAY) ** 2).mean()), difference
