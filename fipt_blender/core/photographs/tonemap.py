# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight-bit copies of HDR photographs: for features, alike in the dark and in the light, and for display."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter

from ..capture.encoded import srgb_encoded

_REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
# Below the median radiance by this factor, the curve turns from logarithmic to linear: darker is noise.
DARKEST = 2.0**-6
_LOW, _HIGH = 0.5, 99.8  # percentiles that become black and white
# Of the picture for networks: the light of a neighborhood, which is a part of the shorter side wide, is
# compressed to stops between its 5th and 95th percentile; detail keeps its contrast.
_NEIGHBORHOOD, _STOPS = 0.25, 2.0
_EDGE = 0.5  # stops of contrast within a neighborhood, from which it is an edge and not detail
_WHITE = 95.0  # percentile of the brightest channel that becomes white in a picture for display


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


def display_picture(radiance: np.ndarray) -> np.ndarray:
    """A photograph as a camera's JPEG shows it: exposed for most of it, with clipped lamps.

    Args:
        radiance: (height, width, 3) scene-linear, finite.

    Returns:
        (height, width, 3) uint8, sRGB.
    """
    white = float(np.percentile(radiance.max(axis=-1), _WHITE))
    values = np.clip(radiance / max(white, 1e-12), 0.0, 1.0)
    return np.round(255.0 * srgb_encoded(values)).astype(np.uint8)


def network_picture(radiance: np.ndarray) -> np.ndarray:
    """A photograph with windows, lamps and dark corners at once, as networks see most in it.

    The base of the logarithm of luminance, a guided filter of it (He et al., ECCV 2010) without halos at
    edges, is compressed; the rest and the colors stay.

    Args:
        radiance: (height, width, 3) scene-linear, finite.

    Returns:
        (height, width, 3) uint8, sRGB.
    """
    luminance = np.maximum(radiance @ _REC709_LUMINANCE, 0.0).astype(np.float64)
    positive = luminance[luminance > 0.0]
    if not positive.size:
        return np.zeros(radiance.shape, np.uint8)
    stops = np.log2(luminance + DARKEST * np.median(positive))
    side = max(3, round(_NEIGHBORHOOD * min(luminance.shape)))
    mean = uniform_filter(stops, side)
    variance = np.maximum(uniform_filter(stops * stops, side) - mean * mean, 0.0)
    share = variance / (variance + _EDGE**2)
    base = uniform_filter(share, side) * stops + uniform_filter((1.0 - share) * mean, side)
    low, middle, high = np.percentile(base, [5.0, 50.0, 95.0])
    strength = min(1.0, _STOPS / max(float(high - low), 1e-6))
    gain = np.exp2((strength - 1.0) * (base - middle))
    return display_picture((radiance * gain[..., None]).astype(np.float32))
