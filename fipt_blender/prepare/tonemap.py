# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight-bit copies of HDR photographs for features, alike in the dark and in the light."""

from __future__ import annotations

import numpy as np

_REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
# Below the median radiance by this factor, the curve turns from logarithmic to linear: darker is noise.
DARKEST = 2.0**-6
_LOW, _HIGH = 0.5, 99.8  # percentiles that become black and white


def tone_mapped(radiance: np.ndarray) -> np.ndarray:
    """A logarithmic copy of a photograph, on which SIFT finds equal contrast at any brightness.

    Args:
        radiance: (height, width, 3) scene-linear, finite.

    Returns:
        (height, width) uint8 luminance.
    """
    luminance = np.maximum(radiance @ _REC709_LUMINANCE, 0.0)
    positive = luminance[luminance > 0.0]
    if not positive.size:
        return np.zeros(luminance.shape, np.uint8)
    encoded = np.log2(luminance + DARKEST * np.median(positive))
    low, high = np.percentile(encoded, [_LOW, _HIGH])
    scaled = (encoded - low) / max(float(high - low), 1e-6)
    return np.round(255.0 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8)
