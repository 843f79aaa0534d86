# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photograph's header says: size, exposure, camera, lens, time. Pixels are not decoded.

Headers come from cameras, phones and other programs; whatever is missing or makes no sense is None.
"""

from __future__ import annotations

import contextlib
import logging
import struct
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import exifread
import rawpy
from exifread.core.exceptions import ExifError
from PIL import Image, UnidentifiedImageError

from ..capture.encoded import MOST_PIXELS, exif_number, relative_exposure
from ..capture.images import EXR_SUFFIX, read_size
from ..capture.suffixes import HEIF_SUFFIXES, LDR_FORMATS, LINEAR_SUFFIXES, RAW_SUFFIXES
from ..run.errors import FiptError
from . import radiance_hdr
from .extras import optional
from .preparation import Photograph

# What the libraries raise for damaged or hostile files.
DAMAGE = (
    *(OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, AssertionError, SyntaxError),
    *(struct.error, EOFError, OverflowError, ZeroDivisionError, RecursionError, UnidentifiedImageError),
    *(rawpy.LibRawError, ExifError, RuntimeError, NotImplementedError, MemoryError),
    Image.DecompressionBombError,
)
_TIMES = (
    ("EXIF DateTimeOriginal", "EXIF SubSecTimeOriginal"),
    ("EXIF DateTimeDigitized", "EXIF SubSecTimeDigitized"),
    ("Image DateTime", "EXIF SubSecTime"),
)
# What maker notes (Nikon, Sony, Olympus) call the correction of vignetting, and how they say that it is off.
_CORRECTIONS = tuple(
    f"MakerNote {name}" for name in ("VignetteControl", "VignettingCorrection", "ShadingCompensation")
)
_OFF, _UNKNOWN = ("off", "none", "0"), ("n/a", "unknown", "")
# ExifRead says on its log what is wrong with a header; a missing value is all that matters here.
logging.getLogger("exifread").setLevel(logging.CRITICAL)


def kind_of(path: Path) -> str | None:
    """``raw``, ``ldr`` or ``linear`` by the suffix, None for files that are no photographs."""
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return "raw"
    if suffix in LDR_FORMATS:
        return "ldr"
    return "linear" if suffix in LINEAR_SUFFIXES else None


def describe(path: Path, name: str) -> Photograph:
    """A photograph as its header describes it.

    Args:
        path: of the file.
        name: the path by which prepare.json names it.

    Raises:
        FiptError: ``photograph-unreadable``, ``image-too-large`` or ``package-optional``.
    """
    kind = kind_of(path)
    if kind is None:
        raise unreadable(path, "its format is not known")
    try:
        if path.stat().st_size == 0:
            raise unreadable(path, "the file is empty")
        tags = _tags(path) if kind != "linear" else {}
        corrected = _corrected(path) if kind == "ldr" else None
        width, height, other = _size(path, kind, tags)
        tags = {**other, **tags}
    except DAMAGE as error:
        raise unreadable(path, error) from None
    if width < 1 or height < 1 or width * height > MOST_PIXELS:
        raise FiptError(
            "image-too-large",
            f"{path} has {width} x {height} pixels; the limit is {MOST_PIXELS / 1e6:.0f} megapixels.",
            "Scale it down, or remove it.",
        )
    return replace(_photograph(name, kind, (width, height), tags), corrected=corrected)


def unreadable(path: Path, reason: object) -> FiptError:
    """The error for a photograph that can't be read."""
    if isinstance(reason, rawpy.LibRawError) and reason.args and isinstance(reason.args[0], bytes):
        reason = reason.args[0].decode(errors="replace")
    return FiptError(
        "photograph-unreadable",
        f"{path} can't be read ({reason}).",
        "Copy it from the camera again, or remove it from the folder.",
    )


def _photograph(name: str, kind: str, size: tuple[int, int], tags: Mapping[str, Any]) -> Photograph:
    shutter = _number(tags, "EXIF ExposureTime")
    if shutter is None and (value := _number(tags, "EXIF ShutterSpeedValue", least=-30.0)) is not None:
        shutter = 2.0**-value
    aperture = _number(tags, "EXIF FNumber")
    iso = _number(tags, "EXIF ISOSpeedRatings") or _number(tags, "EXIF PhotographicSensitivity")
    exposure = relative_exposure(shutter, aperture, iso)
    return Photograph(
        path=name,
        kind=kind,
        width=size[0],
        height=size[1],
        # LibRaw gives a sensor's values as they lie; programs that wrote linear images have turned them.
        orientation=1 if kind == "linear" else int(_number(tags, "Image Orientation", 1.0, 8.0) or 1),
        shutter=shutter,
        aperture=aperture,
        iso=iso,
        focal_length=_number(tags, "EXIF FocalLength"),
        focal_35mm=_number(tags, "EXIF FocalLengthIn35mmFilm"),
        make=_text(tags, "Image Make"),
        model=_text(tags, "Image Model"),
        lens=_text(tags, "EXIF LensModel") or _text(tags, "MakerNote LensModel"),
        time=_time(tags),
        # Values of linear images are radiance already, unless they say how they were exposed.
        exposure=1.0 if exposure is None and kind == "linear" else exposure,
    )


def _size(path: Path, kind: str, tags: Mapping[str, Any]) -> tuple[int, int, dict[str, Any]]:
    """Width, height, and what the format's own library knows besides, as EXIF tags."""
    suffix = path.suffix.lower()
    if kind == "raw":
        with rawpy.imread(str(path)) as raw:
            return raw.sizes.width, raw.sizes.height, _raw_tags(raw, tags)
    if suffix == EXR_SUFFIX:
        return *read_size(path), {}
    if kind == "linear":
        return *radiance_hdr.read_size(path), {}
    if suffix in HEIF_SUFFIXES:
        optional("pillow_heif", "A photograph in HEIC").register_heif_opener()
    with Image.open(path, formats=[LDR_FORMATS[suffix]]) as image:
        return *image.size, {}


def _raw_tags(raw: rawpy.RawPy, tags: Mapping[str, Any]) -> dict[str, Any]:
    """What LibRaw knows where the header's tags say nothing; zero stands for unknown there."""
    # LibRaw's flip: 3 upside down, 5 to be turned left, 6 to be turned right.
    known: dict[str, Any] = {"Image Orientation": {3: 3, 5: 8, 6: 6}.get(raw.sizes.flip, 1)}
    if "EXIF ExposureTime" not in tags:  # asking for the exposure decodes the whole photograph
        other = raw.other
        known |= {
            "EXIF ExposureTime": other.shutter_speed,
            "EXIF FNumber": other.aperture,
            "EXIF ISOSpeedRatings": other.iso_speed,
            "EXIF FocalLength": other.focal_length,
        }
    return {name: value for name, value in known.items() if value}


def _tags(path: Path) -> dict[str, Any]:
    """EXIF tags by ExifRead's names; none where the file has none or they are damaged."""
    with path.open("rb") as file:
        try:
            found = exifread.process_file(file, details=False, extract_thumbnail=False)
        except DAMAGE:
            return {}
    return {name: tag.values for name, tag in found.items() if hasattr(tag, "values")}


def _corrected(path: Path) -> bool | None:
    """Whether a camera's JPEG has no vignetting any more, by its maker note."""
    with path.open("rb") as file:
        try:
            found = exifread.process_file(file, details=True, extract_thumbnail=False)
        except DAMAGE:
            return None
    texts = [str(found[name].printable).strip(" []").casefold() for name in _CORRECTIONS if name in found]
    known = [text not in _OFF for text in texts if text not in _UNKNOWN]
    return known[0] if known else None


def _number(tags: Mapping[str, Any], name: str, least: float = 1e-9, most: float = 1e9) -> float | None:
    return exif_number(tags.get(name), least, most)


def _text(tags: Mapping[str, Any], name: str) -> str:
    value = tags.get(name, "")
    return "".join(c for c in value if c.isprintable()).strip()[:200] if isinstance(value, str) else ""


def _time(tags: Mapping[str, Any]) -> float | None:
    """Seconds since 1970 as if the camera's clock showed UTC."""
    for name, fraction in _TIMES:
        with contextlib.suppress(ValueError):
            stamp = datetime.strptime(_text(tags, name)[:19] + " +0000", "%Y:%m:%d %H:%M:%S %z").timestamp()
            digits = _text(tags, fraction)
            return stamp + (float(f"0.{digits}") if digits.isascii() and digits.isdigit() else 0.0)
    return None
