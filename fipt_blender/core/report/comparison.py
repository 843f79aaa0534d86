# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of a render with a photograph: tone mapping, PSNR and false colours.

Numpy only: Blender's side, the report and the benchmarks import it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GAMMA = 1.0 / 2.2  # of display values, roughly sRGB's
ERROR_FULL = 0.25  # difference of display values that has the brightest colour
# Stops of a perceptually uniform colour map from black through purple and orange to pale yellow.
ERROR_STOPS = np.array(
    [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]], np.float32
)


@dataclass(frozen=True)
class Agreement:
    """Agreement of a render with its photograph in dB; infinite if they are equal.

    Attributes:
        psnr: PSNR of tone-mapped values (paper, Sec. 6.2: clipped to [0, 1], γ = 1/2.2).
        psnr_linear: PSNR of scene-linear values clipped to [0, 1].
    """

    psnr: float
    psnr_linear: float


def choose_exposure(median_radiance: float) -> float:
    """Factor on radiance before display and PSNR: 1 unless the photographs would be nearly black or white.

    Args:
        median_radiance: of the photographs that are shown.
    """
    if not median_radiance > 0.0 or 0.02 <= median_radiance <= 1.0:
        return 1.0
    return 0.18 / median_radiance


def clipped(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Scene-linear values clipped to [0, 1], float64; NaN becomes 0."""
    scaled = np.asarray(radiance, np.float64) * exposure
    return np.clip(np.nan_to_num(scaled, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)


def tone_mapped(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Radiance clipped to [0, 1] and raised to 1/2.2 (paper, Sec. 6.2), float64."""
    return clipped(radiance, exposure) ** GAMMA


def to_display(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Display values (…, 3) f32 in [0, 1]: `tone_mapped` for pictures."""
    return tone_mapped(radiance, exposure).astype(np.float32)


def psnr_of(squared_error: float) -> float:
    """PSNR in dB for a mean squared error of values in [0, 1]; infinite for 0."""
    return float("inf") if squared_error == 0.0 else -10.0 * float(np.log10(squared_error))


def psnr(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB of two scene-linear images, on their tone-mapped values."""
    return psnr_of(float(np.mean((tone_mapped(estimate, exposure) - tone_mapped(truth, exposure)) ** 2)))


def compare(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> Agreement:
    """Both PSNRs of two scene-linear images (H, W, 3)."""
    linear = float(np.mean((clipped(estimate, exposure) - clipped(truth, exposure)) ** 2))
    return Agreement(psnr(estimate, truth, exposure), psnr_of(linear))


def error_colors(position: np.ndarray) -> np.ndarray:
    """False colours (…, 3) f32, display values, of positions (…) on the colour map from 0 to 1."""
    at = np.arange(len(ERROR_STOPS))
    place = np.clip(position, 0.0, 1.0) * (len(ERROR_STOPS) - 1)
    channels = [np.interp(place, at, ERROR_STOPS[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32) / 255.0


def error_picture(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Mean absolute difference of display values in false colours (H, W, 3); ERROR_FULL is the brightest."""
    difference = np.abs(tone_mapped(estimate, exposure) - tone_mapped(truth, exposure)).mean(axis=-1)
    return error_colors(difference / ERROR_FULL)
