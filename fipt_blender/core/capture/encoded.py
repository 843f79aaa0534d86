# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that are not HDR: codes of JPEG, PNG and TIFF files, and the exposures in their EXIF.

Their response is unknown. They are read as if it were sRGB's curve, which can be undone without loss; the
radiometric adjustment does so.
"""

from __future__ import annotations

import math
import struct
import sys
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ExifTags, Image, UnidentifiedImageError

from ..run.errors import FiptError
from ..run.shapes import MOST_SIDE

PILLOW_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".tif": "TIFF", ".tiff": "TIFF"}
JPEG_SUFFIXES = (".jpg", ".jpeg")
# A float image of three channels takes 2 GB; the largest cameras have 151 megapixels.
MOST_PIXELS = 160_000_000
# Codes from which on a channel counts as clipped: JPEG's noise blurs the end of the scale.
CLIPPED_CODE = 250.0
# What Pillow raises for damaged files.
DAMAGE = (
    *(UnidentifiedImageError, OSError, ValueError, SyntaxError, struct.error, EOFError, OverflowError),
    *(Image.DecompressionBombError, zlib.error),
)
# Pillow's names of pixels with 16 bits in each of three channels, and those with the bytes swapped.
_ORDERS = {"B": "L", "L": "B", "N": "B" if sys.byteorder == "little" else "L"}
_OTHER_ORDER = {
    f"{channels};16{order}": f"{channels};16{other}"
    for channels in ("RGB", "RGBA", "RGBX")
    for order, other in _ORDERS.items()
}


def is_encoded(path: Path) -> bool:
    """Whether a photograph's file has a format of codes instead of radiance, by its suffix."""
    return path.suffix.lower() in PILLOW_FORMATS


def read_encoded(path: Path) -> np.ndarray:
    """A photograph's values as if its response were sRGB's curve.

    Alpha is ignored.

    Returns:
        (height, width, 3) float32 from 0 to 1.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable`` or ``image-too-large``.
    """
    pillow_size(path)  # its errors
    try:
        codes = load_codes(path, PILLOW_FORMATS[path.suffix.lower()])
    except DAMAGE as error:
        raise unreadable(path, error) from None
    # By a table, since powers of all pixels would take seconds.
    most = np.iinfo(codes.dtype).max
    table = srgb_decoded(np.arange(most + 1, dtype=np.float32) / np.float32(most))
    return np.take(table, codes, mode="clip")  # no code is clipped; to check that would take longer


def load_codes(path: Path, kind: str) -> np.ndarray:
    """The codes of an image with all their bits, without alpha.

    Args:
        kind: Pillow's name of the file's format.

    Returns:
        (height, width, 3) uint8, or uint16 where the file has 16 bits in each channel.

    Raises:
        OSError, ValueError, SyntaxError, ...: whatever Pillow raises for damaged files.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with Image.open(path, formats=[kind]) as image:
            if image.mode.startswith(("I", "F")):
                grey = np.asarray(image)
                if grey.dtype != np.uint16:
                    raise ValueError(f"its values are {grey.dtype}, not of 8 or 16 bits")
                return np.repeat(grey[..., None], 3, axis=-1)
            wide = any(_other_bytes(tile) != tile for tile in image.tile)
            codes = np.asarray(image.convert("RGB"))
        if not wide:
            return codes
        with Image.open(path, formats=[kind]) as image:
            image.tile = [_other_bytes(tile) for tile in image.tile]
            lower = np.asarray(image.convert("RGB"))
    return (codes.astype(np.uint16) << 8) | lower


def file_exposure(path: Path) -> float | None:
    """The relative exposure by a file's EXIF; None without."""
    if not is_encoded(path):
        return None
    try:
        with Image.open(path, formats=[PILLOW_FORMATS[path.suffix.lower()]]) as image:
            tags = image.getexif().get_ifd(ExifTags.IFD.Exif)
            names = (ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings)
            shutter, aperture, iso = (exif_number(tags.get(name)) for name in names)
    except (*DAMAGE, KeyError, TypeError):
        return None
    return relative_exposure(shutter, aperture, iso)


def relative_exposure(shutter: float | None, aperture: float | None, iso: float | None) -> float | None:
    """The light that reaches the values: shutter * iso / (100 * aperture²); None without a shutter time.

    Lenses without contacts report no aperture: it counts as 1 then, as it does not change within a bracket.
    """
    if shutter is None:
        return None
    return shutter * (100.0 if iso is None else iso) / 100.0 / (1.0 if aperture is None else aperture) ** 2


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
    return FiptError("image-missing", f"The image {path} does not exist.", "Restore it, or correct its path.")


def unreadable(path: Path, reason: object) -> FiptError:
    """The error for a file that can't be read."""
    return FiptError("image-unreadable", f"{path} can't be read ({reason}).", "Export the image again.")


def check_pixels(path: Path, width: int, height: int) -> None:
    """Refuse images that would not fit into memory, whatever their header says.

    Raises:
        FiptError: ``image-too-large`` or ``image-unreadable``.
    """
    if width < 1 or height < 1:
        raise unreadable(path, f"its size is {width} x {height}")
    if max(width, height) > MOST_SIDE or width * height > MOST_PIXELS:
        raise _too_large(path, f"{width} x {height}")


def _too_large(path: Path, size: str) -> FiptError:
    return FiptError(
        "image-too-large",
        f"{path} has {size} pixels; the limit is {MOST_PIXELS / 1e6:.0f} megapixels.",
        "Scale the photographs and masks down; 1 to 2 megapixels per view are enough.",
    )


def pillow_size(path: Path) -> tuple[int, int]:
    """Size of an image that is no EXR, from its header, if it is in the format that its suffix names.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable`` or ``image-too-large``.
    """
    if not path.is_file():
        raise missing(path)
    kind = PILLOW_FORMATS.get(path.suffix.lower())
    if kind is None:
        raise unreadable(path, "its format is not known")
    try:
        with Image.open(path, formats=[kind]) as image:
            size = image.size
    except Image.DecompressionBombError:  # Pillow's own limit lies above ours
        raise _too_large(path, "too many") from None
    except DAMAGE as error:
        raise unreadable(path, error) from None
    check_pixels(path, *size)
    return size


def _other_bytes(tile: Any) -> Any:
    """A tile whose channels of 16 bits yield their lower bytes, by the other order of bytes; others stay.

    Pillow reads the upper bytes only.
    """
    single = isinstance(tile.args, str)
    names = (tile.args,) if single else tuple(tile.args or ())
    changed = tuple(_OTHER_ORDER.get(name, name) if isinstance(name, str) else name for name in names)
    return tile if changed == names else tile._replace(args=changed[0] if single else changed)


def exif_number(value: Any, least: float = 1e-9, most: float = 1e9) -> float | None:
    """A number of an EXIF tag within bounds, None where there is none."""
    if isinstance(value, (tuple, list)):
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and least <= number <= most else None
