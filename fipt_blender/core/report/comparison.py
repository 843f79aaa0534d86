"""Comparison of a render with a photograph: tone mapping, PSNR and false colours.

Numpy only: Blender's side, the report and the benchmarks import it.
"""

from __future__ import annotations

import numpy as np

GAMMA = 1.0 / 2.2  # of display values, roughly sRGB's
ERROR_FULL = 0.25  # difference of display values that has the brightest colour
# Stops of a perceptually uniform colour map from black through purple and orange to pale yellow.
ERROR_STOPS = np.array(
    [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]], np.float32
)


def choose_exposure(median_radiance: float) -> float:
    """Factor on radiance before display and PSNR: 1 unless the photographs would be nearly black or white.

    Args:
        median_radiance: of the photographs that are shown.
    """
    if not median_radiance > 0.0 or 0.02 <= median_radiance <= 1.0:
        return 1.0
    return 0.18 / median_radiance


def tone_mapped(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Radiance clipped to [0, 1] and raised to 1/2.2 (paper, Sec. 6.2), float64; NaN becomes 0."""
    scaled = np.asarray(radiance, np.float64) * exposure
    return np.clip(np.nan_to_num(scaled, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0) ** GAMMA


def to_display(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Display values (…, 3) f32 in [0, 1]: `tone_mapped` for pictures."""
    return tone_mapped(radiance, exposure).astype(np.float32)


def psnr_of(squared_error: float) -> float:
    """PSNR in dB for a mean squared error of values in [0, 1]; infinite for 0."""
    return float("inf") if squared_error == 0.0 else -10.0 * float(np.log10(squared_error))


def psnr(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB of two scene-linear images, on their tone-mapped values."""
    return psnr_of(float(np.mean((tone_mapped(estimate, exposure) - tone_mapped(truth, exposure)) ** 2)))


def error_picture(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Mean absolute difference of display values in false colours (H, W, 3); ERROR_FULL is the brightest."""
    difference = np.abs(tone_mapped(estimate, exposure) - tone_mapped(truth, exposure)).mean(axis=-1)
    place = np.clip(difference / ERROR_FULL, 0.0, 1.0) * (len(ERROR_STOPS) - 1)
    channels = [np.interp(place, np.arange(len(ERROR_STOPS)), stops) for stops in ERROR_STOPS.T]
    return np.stack(channels, axis=-1).astype(np.float32) / 255.0
