# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of a photograph against what it should show: the small turn of the camera by which both agree
best, by Gauss-Newton from coarse to fine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Standard deviations in pixels of the blur at which images are compared, one after another.
BLURS = (6.0, 3.0, 1.5)
STEPS = 6
# Residuals of log radiance above about this are stray (highlights, edges, people).
STRAY = 0.15
# Displacements above this many pixels need proof; keeps plain walls from drifting along their noise.
EXPECTED_SHIFT = 2.0
LEAST_PIXELS = 200


@dataclass(frozen=True)
class Fit:
    """How well a photograph lies where its pose says.

    Attributes:
        shift: root mean square of the displacement that registration finds, in pixels.
        improvement: robust residual after registration as a share of that before; 1 where nothing is gained.
        gain: robust residual (mean of log(1 + (r / STRAY)^2)) before registration minus that after it.
        difference: median absolute difference of log radiance after registration.
    """

    shift: float
    improvement: float
    gain: float
    difference: float


def register(shown: np.ndarray, told: np.ndarray, known: np.ndarray, intrinsics: np.ndarray) -> Fit:
    """Find the camera's rotation by which `shown` agrees best with `told`.

    A camera that stands elsewhere shows as a turn too, but for parallax.

    Args:
        shown: (H, W) log radiance of the photograph.
        told: (H, W) log radiance that the other views tell.
        known: (H, W) bool, where both are known.
        intrinsics: (3, 3) in pixels of these images.
    """
    if known.sum() < LEAST_PIXELS:
        return Fit(0.0, 1.0, 0.0, 0.0)
    flow = _flow(known.shape, intrinsics)
    size = np.sqrt((flow**2).sum(axis=1).mean(axis=(1, 2)))
    flow = flow[:, :, known]
    turn = np.zeros(len(flow))
    for blur in BLURS:
        one, other = _blurred(shown, known, blur), _blurred(told, known, blur)[known]
        gradient_y, gradient_x = np.gradient(one)
        # A pull towards the given pose, in proportion to what the residuals leave undecided; blur makes so
        # many pixels say the same.
        pull = 4.0 * np.pi * blur**2 * (size / EXPECTED_SHIFT) ** 2
        for _ in range(STEPS):
            turn = turn + _step([one, gradient_x, gradient_y], other, known, flow, turn, pull)
    # Both are judged at the last blur, the finest.
    before, _ = _cost(one, other, known, flow, np.zeros(len(turn)))
    after, difference = _cost(one, other, known, flow, turn)
    length = float(np.sqrt((_shift(turn, flow) ** 2).sum(axis=0).mean()))
    return Fit(length, min(after / max(before, 1e-12), 1.0), before - after, difference)


def _flow(shape: tuple[int, ...], intrinsics: np.ndarray) -> np.ndarray:
    """(3, 2, H, W) displacement of each pixel (x, y) by a small turn about each axis of the camera."""
    height, width = shape
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    x = (np.arange(width) + 0.5 - intrinsics[0, 2])[None] / fx + np.zeros((height, 1))
    y = (np.arange(height) + 0.5 - intrinsics[1, 2])[:, None] / fy + np.zeros((1, width))
    axes = [(-x * y, -(1.0 + y**2)), (1.0 + x**2, x * y), (-y, x)]
    return np.array([[fx * dx, fy * dy] for dx, dy in axes])


def _blurred(image: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """The image blurred over its known pixels."""
    reach = int(3.0 * sigma) + 1
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    total, weight = image * known, known.astype(np.float64)
    for axis in range(2):
        total, weight = (_convolve(values, kernel, axis) for values in (total, weight))
    return total / np.maximum(weight, 1e-12)


def _convolve(image: np.ndarray, kernel: np.ndarray, axis: int) -> np.ndarray:
    reach = len(kernel) // 2
    pad = [(0, 0), (0, 0)]
    pad[axis] = (reach, reach)
    padded = np.pad(image, pad)
    length = image.shape[axis]
    result = np.zeros_like(image)
    for tap, weight in enumerate(kernel):
        part = slice(tap, tap + length)
        result += weight * (padded[part] if axis == 0 else padded[:, part])
    return result


def _shift(turn: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """(2, M) displacement (x, y) of M pixels by a turn, where `flow` (3, 2, M) is that of each axis."""
    return np.einsum("k,kam->am", turn, flow)


def _warp(
    images: list[np.ndarray], known: np.ndarray, shift: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Images looked up beside each of the M known pixels, bilinearly.

    Args:
        shift: (2, M) pixels (x, y).

    Returns:
        (M,) values of each image, and (M,) bool whether they are known.
    """
    height, width = known.shape
    row, column = np.nonzero(known)
    x, y = column + shift[0], row + shift[1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    x0 = np.minimum(x.astype(np.int64), max(width - 2, 0))
    y0 = np.minimum(y.astype(np.int64), max(height - 2, 0))
    u, v = x - x0, y - y0
    weights = [(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u]
    first = y0 * width + x0
    corners = [first, first + 1, first + width, first + width + 1]
    warped = []
    for image in images:
        flat = image.reshape(-1)
        warped.append(sum(w * flat.take(corner) for w, corner in zip(weights, corners, strict=True)))
    everywhere = np.all([known.reshape(-1).take(corner) for corner in corners], axis=0)
    return warped, inside & everywhere


def _step(
    shown: list[np.ndarray],
    told: np.ndarray,
    known: np.ndarray,
    flow: np.ndarray,
    turn: np.ndarray,
    pull: np.ndarray,
) -> np.ndarray:
    """One Gauss-Newton step of the turn, with a factor of exposure fitted along.

    Args:
        shown: the image and its gradients along x and y.
        told: (M,) the other image at the known pixels.
        flow: (3, 2, M) there.
        pull: (3,) towards no turn, for residuals of 1.
    """
    (here, dx, dy), usable = _warp(shown, known, _shift(turn, flow))
    if usable.sum() < LEAST_PIXELS:
        return np.zeros(len(turn))
    residual = (told - here)[usable]
    residual -= np.median(residual)
    weight = 1.0 / (1.0 + (residual / STRAY) ** 2)
    rows = [(axis[0] * dx + axis[1] * dy)[usable] for axis in flow]
    matrix = np.stack([*rows, np.ones(len(residual))], axis=1)
    normal = matrix.T @ (matrix * weight[:, None])
    right = matrix.T @ (weight * residual)
    noise = float(np.average(residual**2, weights=weight)) + 1e-6
    normal[:-1, :-1] += np.diag(noise * pull)
    right[:-1] -= noise * pull * turn
    return np.linalg.solve(normal + 1e-9 * np.eye(len(normal)), right)[:-1]


def _cost(
    shown: np.ndarray, told: np.ndarray, known: np.ndarray, flow: np.ndarray, turn: np.ndarray
) -> tuple[float, float]:
    """Mean robust residual at a turn, and the median absolute one; arguments as in :func:`_step`."""
    (here,), usable = _warp([shown], known, _shift(turn, flow))
    if usable.sum() < LEAST_PIXELS:
        return np.inf, np.inf
    residual = (told - here)[usable]
    difference = float(np.median(np.abs(residual)))
    residual -= np.median(residual)
    return float(np.log1p((residual / STRAY) ** 2).mean()), difference
