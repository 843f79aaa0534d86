"""Photographs that are not HDR: sRGB's curve, clipping, the exposures in their EXIF; errors of image files.

Their response is unknown. They are read as if it were sRGB's curve, which can be undone without loss; the
radiometric adjustment does so.
"""

from __future__ import annotations

import io
import logging
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import exifread
import numpy as np
from exifread.core.exceptions import ExifError

from ..run.errors import FiptError
from ..run.shapes import MOST_SIDE

# A float image of three channels takes 2 GB; the largest cameras have 151 megapixels.
MOST_PIXELS = 160_000_000
# Codes from which on a channel counts as clipped: JPEG's noise blurs the end of the scale.
CLIPPED_CODE = 250.0
_EXIF = b"Exif\0\0"  # before EXIF itself in some containers
# Of copies on which features are found. Below the median radiance by this factor, they turn from logarithmic
# to linear: darker is noise. Percentiles that become black and white.
DARKEST, _RANGE = 2.0**-6, (0.5, 99.8)
_REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
# What libraries raise for damaged files.
DAMAGE = (
    *(OSError, ValueError, TypeError, LookupError, AttributeError, AssertionError, SyntaxError, EOFError),
    *(ArithmeticError, RuntimeError, MemoryError, struct.error, ExifError),
)
# ExifRead says on its log what is wrong with a header; a missing value is all that matters here.
logging.getLogger("exifread").setLevel(logging.CRITICAL)


def exif_tags(source: Path | bytes, details: bool = False) -> dict[str, Any]:
    """EXIF tags of a file by ExifRead's names; none where it has none or they are damaged.

    Args:
        source: the file, or its EXIF.
        details: whether maker notes are read, too.
    """
    try:
        file: BinaryIO
        file = source.open("rb") if isinstance(source, Path) else io.BytesIO(source.removeprefix(_EXIF))
        with file:
            return dict(exifread.process_file(file, details=details, extract_thumbnail=False))
    except DAMAGE:
        return {}


def relative_exposure(tags: Mapping[str, Any]) -> float | None:
    """The light that reaches the values: shutter * iso / (100 * aperture²); None without a shutter time.

    Lenses without contacts report no aperture: it counts as 1 then, as it does not change within a bracket.
    """
    shutter, aperture, iso = shutter_aperture_iso(tags)
    if shutter is None:
        return None
    return shutter * (100.0 if iso is None else iso) / 100.0 / (1.0 if aperture is None else aperture) ** 2


def shutter_aperture_iso(tags: Mapping[str, Any]) -> tuple[float | None, float | None, float | None]:
    """Shutter time in seconds, f-number and sensitivity by EXIF."""
    shutter = exif_number(tags, "EXIF ExposureTime")
    if shutter is None and (value := exif_number(tags, "EXIF ShutterSpeedValue", least=-30.0)) is not None:
        shutter = 2.0**-value
    iso = exif_number(tags, "EXIF ISOSpeedRatings") or exif_number(tags, "EXIF PhotographicSensitivity")
    return shutter, exif_number(tags, "EXIF FNumber"), iso


def exif_number(tags: Mapping[str, Any], name: str, least: float = 1e-9, most: float = 1e9) -> float | None:
    """A number of EXIF within bounds, None where there is none."""
    value: Any = tags.get(name)
    value = getattr(value, "values", value)
    while isinstance(value, (tuple, list)):  # ExifRead nests some
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and least <= number <= most else None


def srgb_decoded(values: np.ndarray) -> np.ndarray:
    """Linear values of sRGB's values, both 0 to 1, in the same type."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(values.dtype)


def is_clipped(values: np.ndarray) -> np.ndarray:
    """Bool of the same shape: which values of a photograph that is not HDR, by sRGB's curve, are clipped."""
    # A quarter of a code below, for the curve's rounding.
    return values >= srgb_decoded(np.array([(CLIPPED_CODE - 0.25) / 255.0], np.float32))[0]


def srgb_encoded(linear: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_decoded`; negative values are 0."""
    positive = np.maximum(linear, 0.0)
    low = positive <= 0.0031308
    return np.where(low, 12.92 * positive, 1.055 * positive ** (1.0 / 2.4) - 0.055).astype(linear.dtype)


def missing(path: Path) -> FiptError:
    """The error for a file that does not exist."""
    return FiptError("image-missing.missing", path=path)


def unreadable(path: Path, reason: object) -> FiptError:
    """The error for a file that can't be read."""
    return FiptError("image-unreadable.unreadable", path=path, reason=reason)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Refuse images that would not fit into memory, whatever their header says."""
    if width < 1 or height < 1:
        raise unreadable(path, f"its size is {width} x {height}")
    if max(width, height) > MOST_SIDE or width * height > MOST_PIXELS:
        raise FiptError(
            "image-too-large", path=path, width=width, height=height, most_pixels=MOST_PIXELS / 1e6
        )


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
    low, high = np.percentile(encoded, _RANGE)
    scaled = (encoded - low) / max(float(high - low), 1e-6)
    return np.round(255.0 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8)
