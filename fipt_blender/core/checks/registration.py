# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of a photograph against a prediction of it: the small rotation of the camera by which the two
agree best, by Gauss-Newton from coarse to fine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

# Standard deviations in pixels of the blurs at which the images are compared, from coarse to fine.
BLURS = (6.0, 3.0, 1.5)
# Gauss-Newton steps at each blur.
STEPS = 6
# Residuals of log radiance well above this are outliers (highlights, edges, people).
STRAY = 0.15
# Standard deviation in pixels of the prior on displacements: plain walls must not drift along their noise.
EXPECTED_SHIFT = 2.0
LEAST_PIXELS = 200


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
    flow = _flow(known.shape, intrinsics)
    size = np.sqrt((flow**2).sum(axis=1).mean(axis=(1, 2)))
    flow = flow[:, :, known]
    rotation = np.zeros(len(flow))
    for blur in BLURS:
        blurred = _blurred(photograph, known, blur)
        gradient_y, gradient_x = np.gradient(blurred)
        images = np.stack([blurred, gradient_x, gradient_y])
        pair = _Pair(images, _blurred(predicted, known, blur)[known], known, flow)
        # Precision of the prior per squared radian. Blur correlates the residuals of 4 pi blur^2 pixels.
        pull = 4.0 * np.pi * blur**2 * (size / EXPECTED_SHIFT) ** 2
        for _ in range(STEPS):
            rotation = rotation + _step(pair, rotation, pull)
    # Both are judged at the last blur, the finest.
    given = _cost(pair, np.zeros(len(rotation)))
    if given is None:
        return NO_VERDICT
    registered = _cost(pair, rotation)
    if registered is None:  # the rotation moves the photograph off the known pixels
        rotation, registered = np.zeros(len(rotation)), given
    (before, _), (after, difference) = given, registered
    shift = float(np.sqrt((pair.displacement(rotation) ** 2).sum(axis=0).mean()))
    return Fit(shift, min(after / max(before, 1e-12), 1.0), before - after, difference)


def _flow(shape: tuple[int, ...], intrinsics: np.ndarray) -> np.ndarray:
    """(3, 2, H, W) displacement (x, y) of each pixel per radian of rotation about each axis of the camera."""
    height, width = shape
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    x = (np.arange(width) + 0.5 - intrinsics[0, 2])[None] / fx + np.zeros((height, 1))
    y = (np.arange(height) + 0.5 - intrinsics[1, 2])[:, None] / fy + np.zeros((1, width))
    axes = [(-x * y, -(1.0 + y**2)), (1.0 + x**2, x * y), (-y, x)]
    return np.array([[fx * dx, fy * dy] for dx, dy in axes])


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
        flow: (K, 2, M) displacement of these pixels, as in :func:`_flow`.
    """

    photograph: np.ndarray
    predicted: np.ndarray
    known: np.ndarray
    flow: np.ndarray

    def displacement(self, rotation: np.ndarray) -> np.ndarray:
        """(2, M) displacement (x, y) in pixels by a small motion (K,)."""
        return np.einsum("k,kam->am", rotation, self.flow)

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


def _step(pair: _Pair, rotation: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step of the rotation; a factor of exposure is fitted with it.

    Args:
        pull: (K,) weight of the prior, for residuals of 1.
    """
    residual, (dx, dy), usable = pair.residuals(rotation)
    if len(residual) < LEAST_PIXELS:
        return np.zeros(len(rotation))
    residual -= np.median(residual)
    weight = 1.0 / (1.0 + (residual / STRAY) ** 2)
    rows = [axis[0] * dx + axis[1] * dy for axis in pair.flow[:, :, usable]]
    matrix = np.stack([*rows, np.ones(len(residual))], axis=1)
    normal = matrix.T @ (matrix * weight[:, None])
    right = matrix.T @ (weight * residual)
    noise = float(np.average(residual**2, weights=weight)) + 1e-6
    normal[:-1, :-1] += np.diag(noise * pull)
    right[:-1] -= noise * pull * rotation
    return np.linalg.solve(normal + 1e-9 * np.eye(len(normal)), right)[:-1]


def _cost(pair: _Pair, rotation: np.ndarray) -> tuple[float, float] | None:
    """Mean robust residual at a rotation, and the median absolute residual; None with too few pixels."""
    residual, _, _ = pair.residuals(rotation)
    if len(residual) < LEAST_PIXELS:
        return None
    difference = float(np.median(np.abs(residual)))
    residual -= np.median(residual)
    return float(np.log1p((residual / STRAY) ** 2).mean()), difference
