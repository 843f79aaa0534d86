"""What a photograph's header says: size, exposure, camera, lens, time. Pixels are not decoded.

Headers come from cameras, phones and other programs; whatever is missing or makes no sense is None.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import rawpy

from ..core.capture import encoded
from ..core.capture.encoded import (
    check_pixels,
    exif_number,
    exif_tags,
    relative_exposure,
    shutter_aperture_iso,
)
from ..core.capture.files import stand_in
from ..core.capture.images import is_picture, open_picture
from ..core.capture.suffixes import RAW_SUFFIXES
from ..core.run.errors import FiptError
from .preparation import Photograph

DAMAGE = (*encoded.DAMAGE, rawpy.LibRawError)  # what the libraries raise for damaged files
JPEG_XL = "52546"  # compression of a DNG, which LibRaw does not read
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


def describe(path: Path, name: str) -> Photograph:
    """A photograph as its header describes it.

    Args:
        path: of the file.
        name: the path by which prepare.json names it.
    """
    if (error := stand_in(path)) is not None:
        raise error
    if path.suffix.lower() not in RAW_SUFFIXES or is_picture(path):
        picture = open_picture(path)
        tags = picture.tags
        if picture.is_encoded:
            return replace(_photograph(name, "ldr", picture.size, tags), corrected=_corrected(path))
        tags = {tag: tags[tag] for tag in tags if tag == "Image Orientation"}  # radiance has no exposure
        return _photograph(name, "linear", picture.size, tags)
    tags = exif_tags(path)
    try:
        if path.stat().st_size == 0:
            raise unreadable(path, "the file is empty")
        if any(name.endswith("Compression") and str(value) == JPEG_XL for name, value in tags.items()):
            raise unreadable(path, "its mosaic is compressed with JPEG XL; export it with lossless JPEG")
        with rawpy.imread(str(path)) as raw:
            size, tags = (raw.sizes.width, raw.sizes.height), _raw_tags(raw, tags) | tags
    except DAMAGE as error:
        raise unreadable(path, error) from None
    check_pixels(path, *size)
    return _photograph(name, "raw", size, tags)


def unreadable(path: Path, reason: object) -> FiptError:
    """The error for a photograph that can't be read."""
    if isinstance(reason, rawpy.LibRawError) and reason.args and isinstance(reason.args[0], bytes):
        reason = reason.args[0].decode(errors="replace")
    return FiptError("photograph-unreadable", path=path, reason=reason)


def _photograph(name: str, kind: str, size: tuple[int, int], tags: Mapping[str, Any]) -> Photograph:
    shutter, aperture, iso = shutter_aperture_iso(tags)
    zoom = exif_number(tags, "EXIF DigitalZoomRatio") or 1.0
    focal = exif_number(tags, "EXIF FocalLength")
    exposure = relative_exposure(tags)
    return Photograph(
        path=name,
        kind=kind,
        width=size[0],
        height=size[1],
        orientation=int(exif_number(tags, "Image Orientation", 1.0, 8.0) or 1),  # pixels are as stored
        shutter=shutter,
        aperture=aperture,
        iso=iso,
        focal_length=zoom * focal if focal else None,
        # Cameras do not agree whether it contains the digital zoom.
        focal_35mm=exif_number(tags, "EXIF FocalLengthIn35mmFilm") if zoom == 1.0 else None,
        make=_text(tags, "Image Make"),
        model=_text(tags, "Image Model"),
        lens=_text(tags, "EXIF LensModel") or _text(tags, "MakerNote LensModel"),
        time=_time(tags),
        # Values of linear images are radiance already.
        exposure=1.0 if exposure is None and kind == "linear" else exposure,
    )


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


def _corrected(path: Path) -> bool | None:
    """Whether a camera's JPEG has no vignetting any more, by its maker note."""
    found = exif_tags(path, details=True)
    texts = [str(found[name].printable).strip(" []").casefold() for name in _CORRECTIONS if name in found]
    known = [text not in _OFF for text in texts if text not in _UNKNOWN]
    return known[0] if known else None


def _text(tags: Mapping[str, Any], name: str) -> str:
    value = tags.get(name, "")
    value = getattr(value, "values", value)
    return "".join(c for c in value if c.isprintable()).strip()[:200] if isinstance(value, str) else ""


def _time(tags: Mapping[str, Any]) -> float | None:
    """Seconds since 1970 as if the camera's clock showed UTC."""
    for name, fraction in _TIMES:
        with contextlib.suppress(ValueError):
            stamp = datetime.strptime(_text(tags, name)[:19] + " +0000", "%Y:%m:%d %H:%M:%S %z").timestamp()
            digits = _text(tags, fraction)
            return stamp + (float(f"0.{digits}") if digits.isascii() and digits.isdigit() else 0.0)
    return None
