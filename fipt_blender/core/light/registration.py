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
    turn = np.zeros(len(flow))
    for blur in BLURS:
        one, other = _blurred(shown, known, blur), _blurred(told, known, blur)
        for _ in range(STEPS):
            turn = turn + _step(one, other, known, flow, turn, blur)
    blur = BLURS[-1]
    one, other = _blurred(shown, known, blur), _blurred(told, known, blur)
    before, _ = _cost(one, other, known, flow, np.zeros(len(turn)))
    after, difference = _cost(one, other, known, flow, turn)
    shift = np.einsum("k,kahw->ahw", turn, flow)
    length = float(np.sqrt((shift**2).sum(axis=0)[known].mean()))
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


def _warp(
    images: list[np.ndarray], known: np.ndarray, shift: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Images looked up `shift` pixels (x, y) beside each pixel, bilinearly, and where that is known."""
    height, width = known.shape
    x = np.arange(width)[None] + shift[0]
    y = np.arange(height)[:, None] + shift[1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    x0 = np.minimum(x.astype(np.int64), max(width - 2, 0))
    y0 = np.minimum(y.astype(np.int64), max(height - 2, 0))
    u, v = x - x0, y - y0
    weights = [(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u]
    corners = [(y0, x0), (y0, x0 + 1), (y0 + 1, x0), (y0 + 1, x0 + 1)]
    warped = [
        sum((w * image[at] for w, at in zip(weights, corners, strict=True)), np.zeros(known.shape))
        for image in images
    ]
    everywhere = np.all([known[at] for at in corners], axis=0)
    return warped, inside & everywhere & known


def _step(
    shown: np.ndarray,
    told: np.ndarray,
    known: np.ndarray,
    flow: np.ndarray,
    turn: np.ndarray,
    blur: float,
) -> np.ndarray:
    """One Gauss-Newton step of the turn, with a factor of exposure fitted along."""
    shift = np.einsum("k,kahw->ahw", turn, flow)
    gradient_y, gradient_x = np.gradient(shown)
    (here, dx, dy), usable = _warp([shown, gradient_x, gradient_y], known, shift)
    if usable.sum() < LEAST_PIXELS:
        return np.zeros(len(turn))
    residual = (told - here)[usable]
    residual -= np.median(residual)
    weight = 1.0 / (1.0 + (residual / STRAY) ** 2)
    rows = [(axis[0] * dx + axis[1] * dy)[usable] for axis in flow]
    matrix = np.stack([*rows, np.ones(len(residual))], axis=1)
    normal = matrix.T @ (matrix * weight[:, None])
    right = matrix.T @ (weight * residual)
    # A pull towards the given pose, in proportion to what the residuals leave undecided; blur makes so many
    # pixels say the same.
    size = np.sqrt((flow**2).sum(axis=1).mean(axis=(1, 2)))
    noise = float(np.average(residual**2, weights=weight)) + 1e-6
    pull = 4.0 * np.pi * blur**2 * noise * (size / EXPECTED_SHIFT) ** 2
    normal[:-1, :-1] += np.diag(pull)
    right[:-1] -= pull * turn
    return np.linalg.solve(normal + 1e-9 * np.eye(len(normal)), right)[:-1]


def _cost(
    shown: np.ndarray, told: np.ndarray, known: np.ndarray, flow: np.ndarray, turn: np.ndarray
) -> tuple[float, float]:
    """Mean robust residual at a turn, and the median absolute one."""
    (here,), usable = _warp([shown], known, np.einsum("k,kahw->ahw", turn, flow))
    if usable.sum() < LEAST_PIXELS:
        return np.inf, np.inf
    residual = (told - here)[usable]
    difference = float(np.median(np.abs(residual)))
    residual -= np.median(residual)
    return float(np.log1p((residual / STRAY) ** 2).mean()), difference
