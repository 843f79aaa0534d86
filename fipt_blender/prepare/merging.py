"""Merging exposures to radiance: means weighted by a noise model times a hat, and what has moved in between.

The weights depend on the value that a first merge expects, not on the noisy value itself, which would prefer
values that noise has raised (Hanji et al. 2020, Noise-Aware Merging of High Dynamic Range Image Stacks).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import nnls

from ..core.radiometry.adjustment import CODE_NOISE
from .frames import BAND_ROWS, Frame, block_mean
from .motion import Motion, warped

# The hat: full weight up to here, none from the ceiling on.
HAT_FROM, HAT_TO = 0.7, 0.97
SAMPLE_SIDE = 384  # the longer side of the grid on which exposures are compared, and moved regions found
UNKNOWN_NOISE = 1e-4, 1e-3  # gain and read noise of a usual sensor
_LEAST_WEIGHT = 1e-9  # so that no sum of weights is zero
MOVED_LOG = 0.15  # regions whose exposures differ by more than this in the logarithm have moved
# Exposures that a fraction of a pixel moved out of the image still count in the last rows and columns, which
# would otherwise be left to the noise of darker ones.
BORDER = 1
_DARK, _BRIGHT = 0.01, 0.85  # linear values that are compared to find them


@dataclass(frozen=True, eq=False)
class Noise:
    """How reliable a linear value is."""

    levels: np.ndarray  # (n,) linear values in growing order, 1 at the ceiling
    weights: np.ndarray  # (n, 3) inverse of the relative variance there, times the hat

    def weigh(self, values: np.ndarray) -> np.ndarray:
        """Weights of linear values (..., 3)."""
        flat = [np.interp(values[..., c], self.levels, self.weights[:, c]) for c in range(3)]
        return np.stack(flat, -1).astype(np.float32)


def sensor_noise(gain: float, read: float) -> Noise:
    """Noise of a sensor: variance gain * value + read², values relative to the ceiling."""
    levels = np.concatenate([[0.0], np.geomspace(1e-5, 1.0, 200), [1.2]])
    weights = levels**2 / (gain * levels + read**2) * hat(levels)
    return Noise(levels, np.repeat(np.maximum(weights, _LEAST_WEIGHT)[:, None], 3, 1))


def code_noise(curve: np.ndarray, uncertainty: np.ndarray) -> Noise:
    """Noise of codes behind a response; see `response.Response`."""
    levels = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 400), [1.2]])
    weights = np.empty((len(levels), 3))
    for channel in range(3):
        logs = np.log(np.maximum(curve[:, channel], 1e-9))
        # Slope over a few codes, of which a recovered curve may have equal ones.
        slope = np.maximum(np.gradient(ndimage.gaussian_filter1d(logs, 2.0)), 1e-3)
        variance = (slope * CODE_NOISE) ** 2 + uncertainty[:, channel] ** 2
        weights[:, channel] = np.interp(levels, curve[:, channel], 1.0 / variance) * hat(levels)
    weights[0] = _LEAST_WEIGHT
    return Noise(levels, np.maximum(weights, _LEAST_WEIGHT))


def hat(values: np.ndarray) -> np.ndarray:
    """1 for values well below the ceiling, falling smoothly to 0 beside it."""
    share = np.clip((HAT_TO - values) / (HAT_TO - HAT_FROM), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def measure_noise(values: np.ndarray, period: int) -> tuple[float, float]:
    """Gain and read noise of a sensor from one photograph's mosaic, relative to the ceiling.

    Neighbours of one channel differ by noise and texture; at each brightness the calmest show the noise.

    Args:
        values: (height, width) mosaic.
        period: distance between places of one channel.
    """
    rows = values[:, : values.shape[1] - 2 * period].astype(np.float32)
    middle = values[:, period:-period].astype(np.float32)
    # The second difference is blind to slopes; noise of variance s² gives it 6 s².
    second = rows - 2.0 * middle + values[:, 2 * period :]
    variance, level = block_mean(second**2, 8).ravel() / 6.0, block_mean(middle, 8).ravel()
    edges = np.quantile(level[level < _BRIGHT], np.linspace(0.0, 1.0, 17)) if (level < _BRIGHT).any() else []
    points = []
    for low, high in itertools.pairwise(edges):
        inside = (level >= low) & (level <= high)
        if inside.sum() >= 8:
            points.append((float(np.median(level[inside])), float(np.quantile(variance[inside], 0.2))))
    if len(points) < 2:
        return UNKNOWN_NOISE
    x, y = np.array(points).T
    y = np.maximum(y, 1e-10)
    # Relative errors: the darkest places determine the read noise.
    design = np.stack([np.maximum(x, 0.0), np.ones_like(x)], -1) / y[:, None]
    scale = np.linalg.norm(design, axis=0)
    gain, read = nnls(design / scale, np.ones_like(y))[0] / scale
    return max(float(gain), 1e-7), max(float(np.sqrt(read)), 1e-5)


def merge_exposures(
    values: Sequence[np.ndarray],
    clipped: Sequence[np.ndarray],
    exposures: Sequence[float],
    noise: Noise,
    choice: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance from aligned exposures.

    Args:
        values: linear values (height, width, 3) of each exposure, shortest first; NaN where it has none.
        clipped: bool (height, width, 3) of each exposure.
        exposures: relative exposures.
        noise: of all.
        choice: (height, width) exposure from which a place is taken alone because it moved, -1 elsewhere.

    Returns:
        Radiance (height, width, 3) float32: value over exposure; and bool (height, width, 3), where no
        exposure is usable, so that radiance is a lower bound.
    """
    usable = [np.isfinite(v) & ~c for v, c in zip(values, clipped, strict=True)]
    if choice is not None and (choice >= 0).any():
        only = [u & ((choice < 0) | (choice == j))[..., None] for j, u in enumerate(usable)]
        lost = ~np.any(only, axis=0)
        usable = [np.where(lost, u, o) for u, o in zip(usable, only, strict=True)]
    radiance = np.zeros(values[0].shape, np.float32)
    for iteration in range(3):  # from the second on with the weights of what the one before has found
        total, weights = np.zeros_like(radiance), np.zeros_like(radiance)
        for value, good, exposure in zip(values, usable, exposures, strict=True):
            clean = np.where(good, value, 0.0).astype(np.float32)
            weight = noise.weigh(radiance * np.float32(exposure) if iteration else clean)
            weight[~good] = 0.0
            total += weight * clean / np.float32(exposure)
            weights += weight
        radiance = np.divide(total, weights, out=np.zeros_like(total), where=weights > 0.0)
    none = ~np.any(usable, axis=0)
    if none.any():
        for value, exposure in zip(reversed(values), reversed(exposures), strict=True):  # the shortest counts
            known = none & np.isfinite(value)
            radiance[known] = (value / np.float32(exposure))[known]
    return radiance, none


def moved_regions(values: Sequence[np.ndarray], sigmas: Sequence[np.ndarray]) -> np.ndarray:
    """Regions in which exposures contradict each other, and the exposure from which each is taken.

    Args:
        values: radiance (rows, columns) of each exposure on a coarse grid, shortest first; NaN if unusable.
        sigmas: relative standard deviations of the same.

    Returns:
        (rows, columns) int8: index of the exposure, -1 where nothing has moved.
    """
    moved = np.zeros(values[0].shape, bool)
    logs = [np.log(value) for value in values]
    for j, k in itertools.combinations(range(len(logs)), 2):
        ratio = logs[j] - logs[k]
        both = np.isfinite(ratio)
        if both.any():
            least = np.maximum(MOVED_LOG, 5.0 * np.hypot(sigmas[j], sigmas[k]))
            moved |= np.abs(ratio - np.median(ratio[both])) > least
    # Edges that are a fraction of a pixel apart leave lines; what has moved has a width.
    moved = ndimage.binary_opening(moved, np.ones((2, 2), bool))
    moved = ndimage.binary_dilation(moved, np.ones((3, 3), bool))
    choice = np.full(moved.shape, -1, np.int8)
    labels, count = ndimage.label(moved, np.ones((3, 3), bool))
    for label, place in enumerate(ndimage.find_objects(labels, count), start=1):
        inside = labels[place] == label
        shares = [np.isfinite(value[place][inside]).mean() for value in values]
        # The longest exposure of those that see most of the region: it has the least noise.
        best = max(range(len(values)), key=lambda j: (round(shares[j], 2), j))
        choice[place][inside] = best
    return choice


def merge_group(
    frames: Sequence[Frame], exposures: Sequence[float], motions: Sequence[Motion], noise: Noise
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radiance and clipped places (height, width, 3), and moved places (height, width).

    Args:
        frames: exposures at the working size, shortest first; those of strangers are left out already.
        exposures: relative exposures.
        motions: of the frames.
        noise: of the frames.
    """
    height, width = frames[0].values.shape[:2]
    choice = _ghosts(frames, exposures, motions, noise)
    radiance = np.empty((height, width, 3), np.float32)
    clipped, moved = np.empty(radiance.shape, bool), np.empty((height, width), bool)
    for start in range(0, height, BAND_ROWS):
        stop = min(start + BAND_ROWS, height)
        bands = [_band(frame, motion, start, stop) for frame, motion in zip(frames, motions, strict=True)]
        rows = np.arange(start, stop) * len(choice) // height
        chosen = choice[rows][:, np.arange(width) * choice.shape[1] // width]
        values, flags = [band[0] for band in bands], [band[1] for band in bands]
        merged, none = merge_exposures(values, flags, exposures, noise, chosen)
        radiance[start:stop], clipped[start:stop] = merged, none
        moved[start:stop] = chosen >= 0
    return radiance, clipped, moved


def in_rec709(
    radiance: np.ndarray, clipped: np.ndarray, balance: np.ndarray, matrix: np.ndarray
) -> np.ndarray:
    """Linear Rec.709 from a camera's channels (height, width, 3).

    Channels clip at different radiances after the balance, so that a white lamp would be magenta: clipped
    channels of a pixel become as bright as the brightest of them.
    """
    balanced = radiance * balance.astype(np.float32)
    highest = np.where(clipped, balanced, 0.0).max(axis=-1, keepdims=True)
    balanced = np.where(clipped, np.maximum(balanced, highest), balanced)
    return np.maximum(balanced @ matrix.T.astype(np.float32), 0.0)


def _band(frame: Frame, motion: Motion, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and clipped places of some rows in the reference's geometry."""
    if motion == Motion():
        return frame.values[start:stop].astype(np.float32), frame.clipped[start:stop]
    values = warped(frame.values, motion, start, stop, BORDER)
    flags = warped(frame.clipped, motion, start, stop, BORDER)
    return values, ~(flags <= 0.0)


def _ghosts(
    frames: Sequence[Frame], exposures: Sequence[float], motions: Sequence[Motion], noise: Noise
) -> np.ndarray:
    """The choice of `moved_regions` on a coarse grid."""
    height, width = frames[0].values.shape[:2]
    factor = max(1, max(height, width) // SAMPLE_SIDE)
    rows, columns = height // factor, width // factor
    radiances, sigmas = [], []
    for frame, motion, exposure in zip(frames, motions, exposures, strict=True):
        mean = np.empty((rows, columns, 3), np.float32)
        for row in range(rows):
            values, flags = _band(frame, motion, row * factor, (row + 1) * factor)
            values = np.where(flags.any(axis=-1, keepdims=True), np.nan, values)
            mean[row] = block_mean(values[:, : columns * factor], factor)[0]
        grey = mean.mean(axis=-1)
        sigma = 1.0 / np.sqrt(noise.weigh(np.nan_to_num(mean)).min(axis=-1)) / factor
        usable = (grey > _DARK) & (grey < _BRIGHT)
        radiances.append(np.where(usable, grey / exposure, np.nan))
        sigmas.append(np.where(usable, sigma, np.nan))
    return moved_regions(radiances, sigmas)
