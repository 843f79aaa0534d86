"""Writes RAW photographs for tests: uncompressed DNG files of 12 or 14 bits with a Bayer mosaic (RGGB).

After Adobe's Digital Negative Specification 1.4 and TIFF 6.0; only the tags that readers need.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

BYTE, ASCII, SHORT, LONG, RATIONAL, SIGNED_RATIONAL = 1, 2, 3, 4, 5, 10
_FORMATS = {BYTE: "B", SHORT: "H", LONG: "I"}
# XYZ to linear Rec.709: the channels of this camera are those of Rec.709.
XYZ_TO_REC709 = (3.2404542, -1.5371385, -0.4985314, -0.969266, 1.8760108, 0.041556, 0.0556434, -0.2040259, 1.0572252)

Tag = tuple[int, Sequence[float] | str]


@dataclass(frozen=True)
class Shot:
    """What the header says of a photograph; see `prepare.preparation.Photograph`."""

    shutter: float
    aperture: float = 8.0
    iso: int = 100
    focal_length: float = 24.0
    time: str = "2026:05:01 12:00:00"
    orientation: int = 1
    model: str = "Model X"


def mosaic_of(image: np.ndarray) -> np.ndarray:
    """(height, width) values of a sensor with the pattern RGGB from (height, width, 3)."""
    mosaic = image[..., 1].copy()
    mosaic[::2, ::2] = image[::2, ::2, 0]
    mosaic[1::2, 1::2] = image[1::2, 1::2, 2]
    return mosaic


def write_dng(path: Path, mosaic: np.ndarray, shot: Shot, black: int, white: int) -> None:
    """Write a mosaic (height, width) uint16; the sizes must be even."""
    height, width = mosaic.shape
    pixels = mosaic.astype("<u2").tobytes()
    inner: Mapping[int, Tag] = {
        33434: (RATIONAL, [shot.shutter]),
        33437: (RATIONAL, [shot.aperture]),
        34855: (SHORT, [shot.iso]),
        36867: (ASCII, shot.time),
        37386: (RATIONAL, [shot.focal_length]),
    }
    outer: dict[int, Tag] = {
        254: (LONG, [0]),
        256: (LONG, [width]),
        257: (LONG, [height]),
        258: (SHORT, [16]),
        259: (SHORT, [1]),
        262: (SHORT, [32803]),
        271: (ASCII, "Make"),
        272: (ASCII, shot.model),
        273: (LONG, [0]),
        274: (SHORT, [shot.orientation]),
        277: (SHORT, [1]),
        278: (LONG, [height]),
        279: (LONG, [len(pixels)]),
        284: (SHORT, [1]),
        33421: (SHORT, [2, 2]),
        33422: (BYTE, [0, 1, 1, 2]),
        34665: (LONG, [0]),
        50706: (BYTE, [1, 4, 0, 0]),
        50708: (ASCII, f"Make {shot.model}"),
        50714: (LONG, [black]),
        50717: (LONG, [white]),
        50721: (SIGNED_RATIONAL, XYZ_TO_REC709),
        50728: (RATIONAL, [1.0, 1.0, 1.0]),
        50778: (SHORT, [21]),  # D65
    }
    start = 8
    inner_start = start + len(_directory(outer, start))
    pixel_start = inner_start + len(_directory(inner, inner_start))
    outer[34665], outer[273] = (LONG, [inner_start]), (LONG, [pixel_start])
    content = struct.pack("<2sHI", b"II", 42, start) + _directory(outer, start) + _directory(inner, inner_start)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content + pixels)


def _directory(tags: Mapping[int, Tag], start: int) -> bytes:
    """A TIFF directory at a place of the file, followed by the values that don't fit into it."""
    entries, values = struct.pack("<H", len(tags)), b""
    values_start = start + 2 + 12 * len(tags) + 4
    for number in sorted(tags):
        kind, value = tags[number]
        data, count = _packed(kind, value)
        if len(data) > 4:
            place = struct.pack("<I", values_start + len(values))
            values += data + b"\0" * (len(data) % 2)
        else:
            place = data.ljust(4, b"\0")
        entries += struct.pack("<HHI", number, kind, count) + place
    return entries + struct.pack("<I", 0) + values


def _packed(kind: int, value: Sequence[float] | str) -> tuple[bytes, int]:
    if isinstance(value, str):
        data = value.encode("ascii") + b"\0"
        return data, len(data)
    if kind in (RATIONAL, SIGNED_RATIONAL):
        parts = [Fraction(number).limit_denominator(1_000_000) for number in value]
        letter = "I" if kind == RATIONAL else "i"
        flat = [item for part in parts for item in (part.numerator, part.denominator)]
        return struct.pack(f"<{len(flat)}{letter}", *flat), len(value)
    return struct.pack(f"<{len(value)}{_FORMATS[kind]}", *(int(number) for number in value)), len(value)
