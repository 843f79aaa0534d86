# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera's response, recovered from brackets: which linear value each code of 8 bits stands for.

Debevec and Malik 1997 (Recovering High Dynamic Range Radiance Maps from Photographs), with the unknown
radiances of the pixels eliminated, so that any number of pixels costs the same memory, and with smoothness
asked of the departure from sRGB's curve instead of the curve itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

from ..core.capture.encoded import srgb_decoded
from ..core.radiometry.response import LEVELS

# Weight of the departure's squared second difference against one sample's squared residual, per sample.
SMOOTHNESS = 30.0
# Weight that keeps codes near sRGB's curve of which no sample says anything.
PRIOR = 1e-4
LOWEST, HIGHEST = 2.0, 250.0  # codes outside are clipped or mostly noise
ANCHOR = 128  # the code whose linear value is sRGB's in each channel, so that grey stays grey


@dataclass(frozen=True, eq=False)
class Response:
    """A recovered response.

    Attributes:
        curve: (256, 3) linear value of each code, increasing, 1 at the highest.
        uncertainty: (256, 3) standard deviation of its logarithm.
    """

    curve: np.ndarray
    uncertainty: np.ndarray


def srgb_curve() -> np.ndarray:
    """(256, 3) linear values of sRGB's codes."""
    return np.repeat(srgb_decoded(np.arange(LEVELS) / (LEVELS - 1.0))[:, None], 3, axis=1)


def recover_response(samples: Sequence[np.ndarray], exposures: Sequence[np.ndarray]) -> Response:
    """The response that explains brackets best.

    Args:
        samples: for each group codes (pixels, frames, 3) float, NaN where a frame's value can't be used.
        exposures: for each group (frames,) relative exposures.

    Raises:
        ValueError: there is no pixel with two usable codes.
    """
    systems = [_systems(codes, times) for codes, times in zip(samples, exposures, strict=True)]
    if not sum(system[channel][2] for system in systems for channel in range(3)):
        raise ValueError("no pixel is well exposed in two photographs")
    curves = np.empty((LEVELS, 3))
    uncertainty = np.empty((LEVELS, 3))
    for channel in range(3):
        parts = [system[channel] for system in systems]
        whole = _solve(parts)
        curves[:, channel] = whole
        # The jackknife: how far the curve moves when one part of the pixels is left out.
        count = len(parts)
        others = [_solve(parts[:i] + parts[i + 1 :]) for i in range(count)] if count > 1 else [whole]
        spread = np.var(others, axis=0) * (count - 1.0) if count > 1 else np.zeros(LEVELS)
        uncertainty[:, channel] = np.sqrt(spread)
    return Response(np.exp(curves - curves[-1:]), uncertainty)


def split_samples(
    codes: np.ndarray, exposures: np.ndarray, parts: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """One group's pixels in parts, so that the uncertainty of a single group can be estimated, too."""
    return [part for part in np.array_split(codes, parts) if len(part)], [exposures] * parts


def _systems(codes: np.ndarray, exposures: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Per channel the normal equations of one group: matrix (256, 256), right side (256,), sum of weights.

    With a pixel's log radiance at its best, the residuals of its frames are r = Q (G d - b), where G d
    interpolates the departure from sRGB at its codes, b is log exposure less sRGB's log value, and Q takes
    the weighted mean away.
    """
    prior = np.log(np.maximum(srgb_curve()[:, 0], 1e-9))
    times = np.log(np.asarray(exposures, np.float64))
    found = []
    for channel in range(3):
        code = codes[..., channel].astype(np.float64)
        usable = (code >= LOWEST) & (code <= HIGHEST)  # NaN is neither
        code = np.where(usable, code, LOWEST)
        hat = np.clip(1.0 - np.abs(code - 127.5) / 127.5, 0.02, 1.0)  # of Debevec and Malik
        weight = np.where(usable, hat, 0.0)
        weight[usable.sum(axis=1) < 2] = 0.0
        low = np.minimum(code.astype(int), LEVELS - 2)
        share = code - low
        target = times[None] - (prior[low] * (1.0 - share) + prior[low + 1] * share)
        found.append(_accumulated(low, share, weight, target))
    return found


def _accumulated(
    low: np.ndarray, share: np.ndarray, weight: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Normal equations of one channel; all arguments (pixels, frames)."""
    matrix, right = np.zeros((LEVELS, LEVELS)), np.zeros(LEVELS)
    total = weight.sum(axis=1)
    inverse = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0.0)
    mean = (weight * target).sum(axis=1) * inverse
    ends = ((low, 1.0 - share), (low + 1, share))
    frames = low.shape[1]
    for j in range(frames):
        for place, part in ends:
            np.add.at(right, place[:, j], weight[:, j] * part[:, j] * (target[:, j] - mean))
        for k in range(frames):
            # Weighted inner products of what is left after the mean is taken away.
            pair = -weight[:, j] * weight[:, k] * inverse + (weight[:, j] if j == k else 0.0)
            for place_j, part_j in ends:
                for place_k, part_k in ends:
                    values = pair * part_j[:, j] * part_k[:, k]
                    matrix += np.bincount(
                        place_j[:, j] * LEVELS + place_k[:, k], values, LEVELS * LEVELS
                    ).reshape(LEVELS, LEVELS)
    return matrix, right, float(weight.sum())


def _solve(parts: Sequence[tuple[np.ndarray, np.ndarray, float]]) -> np.ndarray:
    """(256,) log of the curve, from sums of normal equations; increasing, sRGB's at `ANCHOR`."""
    matrix = sum(part[0] for part in parts)
    right = sum(part[1] for part in parts)
    mean_weight = max(sum(part[2] for part in parts) / LEVELS, 1e-9)
    second = np.diff(np.eye(LEVELS), 2, axis=0)
    system = matrix + mean_weight * (SMOOTHNESS * second.T @ second + PRIOR * np.eye(LEVELS))
    system[ANCHOR, ANCHOR] += 1e6 * mean_weight
    departure = np.linalg.solve(system, right)
    curve = np.log(np.maximum(srgb_curve()[:, 0], 1e-9)) + departure
    curve[1:] = isotonic_regression(curve[1:]).x
    # Equal neighbours would have no inverse.
    return np.maximum.accumulate(curve + 1e-9 * np.arange(LEVELS))
