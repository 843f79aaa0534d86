"""A camera's response, recovered from brackets: which linear value each code of 8 bits stands for.

Debevec and Malik 1997 (Recovering High Dynamic Range Radiance Maps from Photographs), with the unknown
radiances of the pixels eliminated, so that any number of pixels costs the same memory, and with smoothness
asked of the departure from sRGB's curve instead of the curve itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.sparse import csr_matrix, diags

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
    """A recovered response."""

    curve: np.ndarray  # (256, 3) linear value of each code, increasing, 1 at the highest
    uncertainty: np.ndarray  # (256, 3) standard deviation of its logarithm


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
    curves, uncertainty = np.empty((LEVELS, 3)), np.zeros((LEVELS, 3))
    times = [np.asarray(each, np.float64) for each in exposures]
    systems = [
        [_system(codes[..., channel], each) for codes, each in zip(samples, times, strict=True)]
        for channel in range(3)
    ]
    if not any(part[2] for parts in systems for part in parts):
        raise ValueError("no pixel is well exposed in two photographs")
    for channel, parts in enumerate(systems):
        whole: list[Any] = [sum(items) for items in zip(*parts, strict=True)]
        curves[:, channel] = _solve(*whole)
        if len(parts) > 1:  # the jackknife: how far the curve moves when one part of the pixels is left out
            others = [_solve(*(a - b for a, b in zip(whole, part, strict=True))) for part in parts]
            uncertainty[:, channel] = np.sqrt(np.var(others, axis=0) * (len(parts) - 1.0))
    return Response(np.exp(curves - curves[-1:]), uncertainty)


def _system(codes: np.ndarray, exposures: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The normal equations of one group and channel: matrix (256, 256), right side (256,), sum of weights.

    With a pixel's log radiance at its best, the residuals of its frames are r = Q (G d - b), where G d
    interpolates the departure from sRGB at its codes, b is log exposure less sRGB's log value, and Q takes
    the weighted mean away.
    """
    usable = (codes >= LOWEST) & (codes <= HIGHEST)  # NaN is neither
    pixel, frame = np.nonzero(usable & (usable.sum(axis=1, keepdims=True) >= 2))
    code = codes[pixel, frame].astype(np.float64)
    weight = np.clip(1.0 - np.abs(code - 127.5) / 127.5, 0.02, 1.0)  # of Debevec and Malik
    target = np.log(exposures)[frame] - np.interp(code, np.arange(LEVELS), _log_srgb())
    low, row = code.astype(int), np.arange(len(code))
    ends = np.concatenate([1.0 - code + low, code - low]), (np.tile(row, 2), np.concatenate([low, low + 1]))
    design = csr_matrix(ends, (len(code), LEVELS))
    member = csr_matrix((np.ones(len(code)), (pixel, row)), (len(codes), len(code)))
    weighted, total = diags(weight) @ design, np.maximum(member @ weight, 1e-12)
    sums = member @ weighted
    matrix = (design.T @ weighted - sums.T @ diags(1.0 / total) @ sums).toarray()
    right = weighted.T @ target - sums.T @ (member @ (weight * target) / total)
    return matrix, right, float(weight.sum())


def _solve(matrix: np.ndarray, right: np.ndarray, weight: float) -> np.ndarray:
    """(256,) log of the curve, from sums of normal equations; increasing, sRGB's at `ANCHOR`."""
    mean_weight = max(weight / LEVELS, 1e-9)
    second = np.diff(np.eye(LEVELS), 2, axis=0)
    system = matrix + mean_weight * (SMOOTHNESS * second.T @ second + PRIOR * np.eye(LEVELS))
    system[ANCHOR, ANCHOR] += 1e6 * mean_weight
    curve = _log_srgb() + np.linalg.solve(system, right)
    curve[1:] = isotonic_regression(curve[1:]).x
    # Equal neighbours would have no inverse.
    return np.maximum.accumulate(curve + 1e-9 * np.arange(LEVELS))


def _log_srgb() -> np.ndarray:
    return np.log(np.maximum(srgb_curve()[:, 0], 1e-9))
