"""What an image's values mean: primaries and transfer curves by profiles, chromaticities or code points."""

from __future__ import annotations

import difflib
import io
import math
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import OpenImageIO as oiio
from PIL import ImageCms

from ..run.errors import FiptError
from .encoded import srgb_decoded

# x, y of red, green, blue and white.
REC709 = np.array([0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290])
# Color spaces of OpenColorIO by their numbers in ITU-T H.273: BT.709, BT.2020 and Display P3.
_CICP = {1: "lin_rec709", 9: "lin_rec2020", 12: "lin_p3d65"}
_OCIO = "ocio://studio-config-v2.2.0_aces-v1.3_ocio-v2.4"  # within OpenColorIO, with cameras' spaces
# Of its spaces, those of displays, not of a scene; of none; what is no curve with a matrix, and in no file.
_NO_SCENE = re.compile(r".* - Display|Raw|ACEScc|ADX\d+")
CIE_XYZ = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0])
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_ROUNDED = 4e-3  # of colours from 0 to 1; programs round primaries and curves differently


@dataclass(frozen=True, eq=False)
class Colors:
    """How stored values become linear Rec.709."""

    # Linear values (n, 3) of codes (n,) from 0 to 1; None for sRGB's curve, of radiance for none
    curve: Callable[[np.ndarray], np.ndarray] | None = None
    # (3, 3) from the linear values to Rec.709; None where they are Rec.709 already
    matrix: np.ndarray | None = None
    is_log: bool = False  # whether the highest code is far brighter than white, so that codes are radiance


@lru_cache
def spaces() -> dict[str, str]:
    """Color spaces of OpenColorIO by their names and aliases in small letters."""
    config = oiio.ColorConfig(_OCIO)
    names = [name for name in config.getColorSpaceNames() if not _NO_SCENE.fullmatch(name)]
    return {alias.lower(): name for name in names for alias in (name, *config.getAliases(name))}


@lru_cache
def space_colors(name: str, stored: str = "uint8") -> Colors:
    """Colors of values of a type by one of `spaces`; its matrix by what becomes of 0.5 in single channels."""
    space = spaces().get(name.lower())
    if space is None:
        near = {each for alias, each in spaces().items() if name.lower() in alias}
        listed = sorted(near) or difflib.get_close_matches(name, set(spaces().values()), 5, 0.0)
        raise FiptError("colorspace-unknown", name=name, near=", ".join(listed))
    curve, codes = partial(_converted, space), np.linspace(0.0, 1.0, 257)
    grey, usual = curve(codes)[:, 0], codes if stored == "float32" else srgb_decoded(codes)
    matrix = curve(0.5 * np.eye(3)).T @ np.linalg.inv(grey[0] + (grey[128] - grey[0]) * np.eye(3))
    is_usual, is_log = np.allclose(grey, usual, atol=1e-5), bool(grey[-1] > 1.01)
    return Colors(None if is_usual else curve, _unless_rec709(matrix), is_log)


def _converted(space: str, values: np.ndarray) -> np.ndarray:
    """Linear Rec.709 (n, 3) of values (n, 3), or of grey ones (n,)."""
    colors = np.broadcast_to(values.reshape(len(values), -1), (len(values), 3)).astype(np.float32)
    source = oiio.ImageBuf(colors.reshape(math.gcd(len(values), 256), -1, 3))  # a thread takes some rows
    linear = oiio.ImageBufAlgo.colorconvert(source, space, "lin_rec709", False, colorconfig=_OCIO)
    return np.asarray(linear.get_pixels(oiio.FLOAT)).reshape(-1, 3).astype(np.float64)


def xyz_from_rgb(chromaticities: np.ndarray) -> np.ndarray:
    """(3, 3) matrix from linear RGB to CIE XYZ, of which white has a luminance of 1."""
    x, y = np.asarray(chromaticities, np.float64).reshape(4, 2).T
    xyz = np.stack([x, y, 1.0 - x - y])
    if not np.isfinite(xyz).all() or y[3] <= 0.0 or abs(np.linalg.det(xyz[:, :3])) < 1e-6:
        raise ValueError(f"its chromaticities {np.round(chromaticities, 4).tolist()} are impossible")
    return xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3] / y[3])


def to_rec709(chromaticities: np.ndarray) -> np.ndarray | None:
    """(3, 3) from linear values of other primaries to Rec.709 (Bradford white adaptation); None for Rec.709.

    Args:
        chromaticities: (8,) x, y of red, green, blue and white.

    Raises:
        ValueError: they are those of no color space.
    """
    source, target = xyz_from_rgb(chromaticities), xyz_from_rgb(REC709)
    # White of CIE XYZ is that of no light: such values are not relative to a white.
    if np.abs(chromaticities[:6] - CIE_XYZ[:6]).max() > 1e-3:
        adapted = (_BRADFORD @ target.sum(axis=1)) / (_BRADFORD @ source.sum(axis=1))
        source = np.linalg.solve(_BRADFORD, adapted[:, None] * _BRADFORD) @ source
    return _unless_rec709(np.linalg.solve(target, source))


def png_colors(info: dict[Any, Any]) -> Colors:
    """Colors by a PNG's chunks, other than an ICC profile, as Pillow names them.

    Raises:
        ValueError: they make no sense.
    """
    gamma = 0.45455 if "srgb" in info else info.get("gamma", 0.45455)  # what programs write for sRGB's curve
    stated = info.get("chromaticity") if "srgb" not in info else None  # white comes first
    matrix = None if stated is None else to_rec709(np.roll(stated, -2))
    return Colors(None if abs(gamma - 0.45455) < 1e-3 or gamma <= 0.0 else power(1.0 / gamma), matrix)


def cicp_colors(primaries: int, transfer: int) -> Colors:
    """Colors by the numbers of ITU-T H.273 (cICP).

    Raises:
        ValueError: they are those of HDR video, or unusual ones.
    """
    if transfer in (16, 18):
        raise ValueError("it is encoded as HDR video, PQ or HLG; export it without HDR, or as OpenEXR")
    if primaries not in _CICP or transfer not in (1, 6, 8, 13, 14, 15):
        raise ValueError(f"its colors are those of H.273's {primaries} and {transfer}; convert it to sRGB")
    curve = {8: power(1.0), 13: None}.get(transfer, space_colors("camera_rec709").curve)
    return Colors(curve, space_colors(_CICP[primaries]).matrix)


def icc_colors(data: bytes) -> Colors:
    """Colors by an ICC profile.

    Raises:
        ValueError: it is damaged, or not one of three primaries, or of grey, with curves.
    """
    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(data)).profile
        space = profile.xcolor_space.strip()
        count = struct.unpack_from(">I", data, 128)[0]
        entries = (struct.unpack_from(">4sII", data, 132 + 12 * index) for index in range(min(count, 200)))
        tags = {name: data[start : start + size] for name, start, size in entries}
        if space == "GRAY":
            return _colors([tags[b"kTRC"]] * 3, None)
        if space != "RGB" or not profile.is_matrix_shaper:
            raise ValueError(f"it is of {space} by a table; convert the image to sRGB")
        srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).profile
        matrix = np.linalg.solve(_colorants(srgb), _colorants(profile))
        return _colors([tags[name] for name in (b"rTRC", b"gTRC", b"bTRC")], _unless_rec709(matrix))
    except (OSError, LookupError, TypeError, ValueError, struct.error, ImageCms.PyCMSError) as error:
        raise ValueError(f"its color profile can't be used: {error}") from None


def _colorants(profile: ImageCms.core.CmsProfile) -> np.ndarray:
    """(3, 3) from linear values to CIE XYZ with the white of ICC profiles (D50)."""
    return np.array([getattr(profile, f"{name}_colorant")[0] for name in ("red", "green", "blue")]).T


def _colors(tags: list[bytes], matrix: np.ndarray | None) -> Colors:
    curves = [_curve(tag) for tag in tags]
    codes = np.linspace(0.0, 1.0, 256)
    if all(np.abs(curve(codes) - srgb_decoded(codes)).max() < _ROUNDED for curve in curves):
        return Colors(None, matrix)
    return Colors(lambda values: np.stack([curve(values) for curve in curves], axis=-1), matrix)


def _curve(tag: bytes) -> Callable[[np.ndarray], np.ndarray]:
    """The function of an ICC profile's curve, which is a table or has parameters."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        table = np.frombuffer(tag, ">u2", count, 12).astype(np.float64)
        if count > 1:
            return lambda x: np.interp(x, np.linspace(0.0, 1.0, count), table / 65535.0)
        gamma = table[0] / 256.0 if count else 1.0
        return lambda x: x**gamma
    kind = struct.unpack_from(">H", tag, 8)[0]
    numbers = np.frombuffer(tag, ">i4", (1, 3, 4, 5, 7)[kind], 12) / 65536.0
    g, a, b, c, d, e, f = (*numbers[:1], *(numbers[1:] if kind else (1.0, 0.0)), *[0.0] * 6)[:7]
    if kind in (1, 2):  # the curve begins where its argument is 0, after a constant
        c, d, e, f = 0.0, -b / a, c, c
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f)


def power(exponent: float) -> Callable[[np.ndarray], np.ndarray]:
    """A curve for `Colors`."""
    return lambda values: np.repeat((values**exponent)[:, None], 3, axis=1)


def _unless_rec709(matrix: np.ndarray) -> np.ndarray | None:
    return None if np.abs(matrix - np.eye(3)).max() < _ROUNDED else matrix
