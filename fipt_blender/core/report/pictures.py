# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene-linear images to PNG files for the report, and the PSNR of the paper's experiments section."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ..job.runfolder import atomic_path

GAMMA = 1.0 / 2.2
ERROR_FULL = 0.25
# Stops of a colour map whose lightness rises evenly, from black over purple and orange to pale yellow.
_ERROR_STOPS = np.array(
    [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]], np.float32
)


def choose_exposure(median_radiance: float) -> float:
    """Factor before display and PSNR: 1 unless photographs would come out near black or white.

    Args:
        median_radiance: of the photographs shown.
    """
    if not median_radiance > 0.0 or 0.02 <= median_radiance <= 1.0:
        return 1.0
    return 0.18 / median_radiance


def to_display(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Display values (…, 3) f32 in [0, 1]: scene-linear radiance clipped, with γ = 1/2.2 (paper, Sec. 4)."""
    scaled = np.nan_to_num(np.asarray(radiance, np.float32) * exposure, nan=0.0, posinf=1.0, neginf=0.0)
    return np.clip(scaled, 0.0, 1.0) ** np.float32(GAMMA)


def psnr(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB of two scene-linear images, on their display values.

    Images that agree exactly give infinity.
    """
    difference = to_display(estimate, exposure).astype(np.float64) - to_display(truth, exposure)
    mean = float(np.mean(difference**2))
    return float("inf") if mean == 0.0 else -10.0 * float(np.log10(mean))


def error_picture(estimate: np.ndarray, truth: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Mean absolute difference of display values as colours (H, W, 3) in [0, 1]; ERROR_FULL is brightest."""
    difference = np.abs(to_display(estimate, exposure) - to_display(truth, exposure)).mean(axis=-1)
    position = np.clip(difference / ERROR_FULL, 0.0, 1.0) * (len(_ERROR_STOPS) - 1)
    at = np.arange(len(_ERROR_STOPS))
    channels = [np.interp(position, at, _ERROR_STOPS[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32) / 255.0


def resize_to(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """A scene-linear image (H, W, 3) at another size, box filtered so that no energy is lost."""
    if image.shape[:2] == (height, width):
        return image
    channels = [
        np.asarray(
            Image.fromarray(image[..., channel].astype(np.float32)).resize(
                (width, height), Image.Resampling.BOX
            )
        )
        for channel in range(image.shape[2])
    ]
    return np.stack(channels, axis=-1)


def write_png(path: Path, display: np.ndarray) -> None:
    """Write display values in [0, 1], (H, W, 3) or (H, W), as an 8-bit PNG, whole or not at all."""
    values = np.round(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)
    with atomic_path(path) as temporary:
        Image.fromarray(values).save(temporary, format="PNG", optimize=True)
