# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing image files: radiance and codes of photographs, id images. The first row is the top.

A file's content decides what it is, not its suffix. OpenEXR files are read by :mod:`.exr_file`, HEIC by
pillow-heif, all others by OpenImageIO; :mod:`.primaries` says what values mean. Pixels are as the file stores
them: EXIF's orientation is not applied, since cameras are those of the stored pixels.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio
from PIL import Image, PngImagePlugin, WebPImagePlugin

from ..run.errors import FiptError
from ..run.extras import optional
from ..run.runfolder import atomic_path
from ..run.store import refuse_infinite
from . import primaries
from .encoded import (
    DAMAGE,
    check_pixels,
    exif_tags,
    missing,
    relative_exposure,
    srgb_decoded,
    srgb_encoded,
    unreadable,
)
from .exr_file import NOTE, exr_is_plain, exr_size, read_exr, read_exr_values
from .files import stand_in
from .primaries import Colors
from .suffixes import IMAGE_SUFFIXES, RAW_SUFFIXES

EXR_SUFFIX = ".exr"
HALF_MAX = float(np.finfo(np.float16).max)
JPEG_QUALITY = 95  # an error of about one of 255 steps, in places of seven
MAX_PNG_ID = 2**16 - 1  # 16 bits
MAX_ID = 2**24 - 1  # highest id of a colour mask; 32-bit floats represent all of them exactly
FORMATS = "OpenEXR, JPEG, PNG, TIFF, WebP, HEIC and Radiance (.hdr)"
# How the files of each format begin; all but the first two are OpenImageIO's names.
_STARTS = re.compile(
    rb"(?P<exr>v/1\x01)|....ftyp(?P<heif>hei|hev|mif1|msf1)|(?P<jpeg>\xff\xd8\xff)|(?P<png>\x89PNG\r\n)"
    rb"|(?P<tiff>II[*+]\0|MM\0[*+])|(?P<webp>RIFF....WEBP)|(?P<hdr>#\?)|(?P<jpegxl>\xff\x0a|....JXL )",
    re.DOTALL,
)
MOST_CHUNK = 64  # bytes of a PNG's chunk that are read
_TYPES = {"uint8": "uint8", "uint16": "uint16", **dict.fromkeys(("half", "float", "double"), "float32")}


@dataclass(frozen=True, eq=False)
class Picture:
    """What an image's header says.

    Attributes:
        kind: "exr", "heif" or OpenImageIO's name of the format.
        size: width and height in pixels.
        type: of the values: "uint8" or "uint16" are codes, "float32" is radiance.
        colors: what the values mean.
        read: makes the pixels (height, width, channels), with or without alpha.
        exif: where its EXIF is.
    """

    kind: str
    size: tuple[int, int]
    type: str
    colors: Colors
    read: Callable[[], Any]
    exif: Path | bytes


def open_picture(path: Path, layer: str = "") -> Picture:
    """What an image's header says; no pixel is read.

    Args:
        path: of the file.
        layer: of an EXR; see `read_exr`.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable``, ``image-too-large``, ``image-format`` for other
            formats, or ``package-optional``.
    """
    try:
        with path.open("rb") as file:
            found = _STARTS.match(file.read(16))
        kind, suffix = str(found and found.lastgroup), path.suffix.lower()
        if found is None or suffix in RAW_SUFFIXES:
            if (error := stand_in(path)) is not None:
                raise error
            if suffix in IMAGE_SUFFIXES:
                raise ValueError(f"its content is none of {FORMATS}")
            raise FiptError(
                "image-format",
                f"{path} has a format that can't be read; {FORMATS} can.",
                "Export one of these, or prepare the photographs (section Photographs), which reads RAW.",
            )
        if kind == "exr":
            return Picture(kind, exr_size(path), "float32", Colors(), lambda: read_exr(path, layer), b"")
        picture = _open_heif(path) if kind == "heif" else _open_by_oiio(path, kind)
    except FileNotFoundError:
        raise missing(path) from None
    except DAMAGE as error:
        raise unreadable(path, error) from None
    check_pixels(path, *picture.size)
    return picture


def stored_values(path: Path, picture: Picture) -> np.ndarray:
    """Values (height, width, channels) as stored, of which the fourth may be left out.

    Raises:
        FiptError: ``image-unreadable``.
    """
    try:
        pixels = np.asarray(picture.read())
    except DAMAGE as error:
        raise unreadable(path, error) from None
    return pixels[..., None] if pixels.ndim == 2 else pixels


def read_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of an image as it is stored, from its header; raises as `open_picture`."""
    return open_picture(path).size


def is_encoded(path: Path) -> bool:
    """Whether a photograph's file holds codes instead of radiance; raises as `open_picture`."""
    return open_picture(path).type != "float32"


def is_plain(path: Path, layer: str = "") -> bool:
    """Whether programs that know nothing of layers, primaries and curves read what `read_radiance` reads."""
    picture = open_picture(path)
    if picture.kind == "exr":
        return exr_is_plain(path, layer)
    return picture.kind != "heif" and picture.colors.curve is None and picture.colors.matrix is None


def read_radiance(path: Path, layer: str = "") -> np.ndarray:
    """Scene-linear radiance in Rec.709; of images that are not HDR, the values by sRGB's curve.

    Returns:
        (height, width, 3) float32, units as stored; from 0 to 1 where the image is not HDR.

    Raises:
        FiptError: those of `open_picture` and `read_exr`.
    """
    picture = open_picture(path, layer)
    pixels, matrix = _colors_of(path, picture), picture.colors.matrix
    if picture.type != "float32":
        # By a table, since powers of all pixels would take seconds.
        table, curve = _curve_table(picture).astype(np.float32), picture.colors.curve
        # No code is clipped; to check that would take longer.
        pixels = np.take(table[:, 0], pixels, mode="clip") if curve is None else _mapped(table, pixels)
    if matrix is None:
        return pixels
    pixels = pixels @ matrix.T.astype(np.float32)
    return pixels if picture.type == "float32" else np.clip(pixels, 0.0, 1.0)


def read_codes(path: Path, as_stored: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
    """The codes of an image that is not HDR, with all their bits, by sRGB's curve.

    Args:
        path: of the file.
        as_stored: by the file's own curve instead.

    Returns:
        (height, width, 3) uint8, or uint16 where 8 bits are too few, and (3, 3) from the linear values to
        Rec.709; None where they are that.

    Raises:
        FiptError: those of `open_picture`.
    """
    picture = open_picture(path)
    codes = _colors_of(path, picture)
    if picture.colors.curve is not None and not as_stored:
        codes = _mapped(np.round(65535.0 * srgb_encoded(_curve_table(picture))).astype(np.uint16), codes)
    return codes, picture.colors.matrix


def transparent(path: Path) -> np.ndarray | None:
    """(height, width) bool: whose alpha is 0, so that they show nothing; None where none or all are."""
    picture = open_picture(path)
    if picture.kind == "heif":
        return None
    file = oiio.ImageInput.open(str(path))
    alpha = -1 if file is None else file.spec().alpha_channel
    if alpha < 0:
        return None
    values = file.read_image(0, 0, alpha, alpha + 1, "float")
    if values is None or np.shape(values)[:2] != picture.size[::-1]:
        return None
    clear = np.asarray(values)[..., 0] <= 0.0
    return clear if clear.any() and not clear.all() else None


def image_tags(path: Path) -> dict[str, Any]:
    """EXIF tags of an image that are about its pixels as they are read; see `exif_tags`."""
    picture = open_picture(path)
    tags = exif_tags(picture.exif)
    if picture.kind in ("heif", "jpegxl"):  # turned by the decoder, as their containers say
        tags.pop("Image Orientation", None)
    return tags


def file_exposure(path: Path) -> float | None:
    """The relative exposure by the EXIF of an image that is not HDR; None without."""
    return relative_exposure(image_tags(path)) if is_encoded(path) else None


def read_ids(path: Path) -> np.ndarray:
    """Ids of an id image.

    EXR: integer values of the only channel, or of R, else Y. PNG: palette indices or grey values of 1 to 16
    bits; in colour masks, each colour has the id ``red * 65536 + green * 256 + blue``. Colours of 16 bits
    have that of the same colour with 8 bits, and where there is none, the value of red.

    Returns:
        (height, width) int32.

    Raises:
        FiptError: those of `open_picture`, ``mask-not-ids`` where values are not ids.
    """
    kind = open_picture(path).kind
    if kind == "exr":
        values = read_exr_values(path)
        if not np.isfinite(values).all() or np.abs(values - np.round(values)).max(initial=0.0) > 1e-3:
            raise _no_ids(path, "contains fractions", "without anti-aliasing, with one integer per part")
        ids = _red(path, np.round(values).astype(np.int64))
    elif kind == "png":
        ids = _png_ids(path)
    else:
        raise _no_ids(path, "is not a PNG or EXR file (lossy formats change ids)", "as PNG or EXR")
    if np.abs(ids).max(initial=0) > MAX_ID:
        raise _no_ids(path, f"contains ids above {MAX_ID}", "with smaller ids")
    return ids.astype(np.int32)


def write_exr(path: Path, array: np.ndarray, half: bool = False, lossy: bool = False, note: str = "") -> None:
    """Write an image as EXR, completely or not at all.

    Args:
        path: the file; its folder is created if missing.
        array: (height, width, 3) as R, G, B, or (height, width) as Y; converted to float.
        half: 16-bit values, clamped to ±65504, instead of 32-bit.
        lossy: compressed to a quarter, for pictures that are only looked at.
        note: a text in the header, which `exr_note` reads.

    Raises:
        FiptError: ``not-finite``, ``disk-full`` or ``run-unwritable``.
    """
    values = np.asarray(array)
    refuse_infinite(path.name, values)
    if half:
        values = np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)
    else:
        values = values.astype(np.float32)
    planes = {"Y": values} if values.ndim == 2 else dict(zip("RGB", np.moveaxis(values, -1, 0), strict=True))
    compression = OpenEXR.DWAA_COMPRESSION if lossy else OpenEXR.ZIP_COMPRESSION
    header = {"compression": compression, "type": OpenEXR.scanlineimage, **({NOTE: note} if note else {})}
    # Written through memory, because OpenEXR does not report the system's reason for a failure.
    buffer = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def write_codes(path: Path, values: np.ndarray) -> None:
    """Write values (height, width, 3) from 0 to 1 with 8 bits, completely or not at all.

    Args:
        path: .png, with an error of half of a code; or .jpg, for pictures that are only looked at.
        values: by the curve of the codes.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    codes = np.clip(values * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8)
    buffer = io.BytesIO()
    if path.suffix == ".jpg":
        Image.fromarray(codes).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    else:  # the fastest compression: higher ones take four times as long and save a sixth
        Image.fromarray(codes).save(buffer, "PNG", compress_level=1)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def threads_for(pixels: Iterable[int]) -> int:
    """How many threads may hold a decoded photograph each, of views with these numbers of pixels."""
    # One of 12 megapixels takes up to 0.5 GB.
    return max(1, 50_000_000 // max(pixels, default=1))


def write_ids(path: Path, ids: np.ndarray) -> None:
    """Write an id image as PNG with 16 bits, completely or not at all.

    Args:
        path: the file; its folder is created if missing.
        ids: (height, width) int from 0 to `MAX_PNG_ID`.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    buffer = io.BytesIO()
    Image.fromarray(ids.astype(np.uint16)).save(buffer, "PNG")
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def _open_heif(path: Path) -> Picture:
    file = optional("heif", "A photograph in HEIC").open_heif(path, convert_hdr_to_8bit=False)
    icc, nclx = file.info.get("icc_profile"), file.info.get("nclx_profile")
    colors = Colors()
    if icc:
        colors = primaries.icc_colors(icc)
    elif nclx:
        if nclx["transfer_characteristics"] in (16, 18):
            primaries.cicp_colors(1, nclx["transfer_characteristics"])
        corners = [f"color_primary_{name}" for name in ("red", "green", "blue", "white")]
        values = [nclx[f"{corner}_{axis}"] for corner in corners for axis in "xy"]
        colors = Colors(None, primaries.to_rec709(np.array(values)))
    kind = "uint16" if file.mode.endswith("16") else "uint8"
    exif = file.info.get("exif") or b""
    return Picture("heif", tuple(file.size), kind, colors, lambda: np.asarray(file), exif)


def _open_by_oiio(path: Path, kind: str) -> Picture:
    colors = _radiance_colors(path) if kind == "hdr" else Colors()
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)  # colours are not multiplied by alpha
    file = oiio.ImageInput.open(str(path), hints)
    if file is None or file.format_name() != kind:
        raise ValueError(oiio.geterror() or f"it is no valid {kind}; {FORMATS} can be read")
    spec = file.spec()
    name = _TYPES.get(str(spec.format))
    if name is None:
        raise ValueError(f"its values are {spec.format}, not of 8 or 16 bits or floats")
    icc = spec.getattribute("ICCProfile")
    if icc is not None:
        colors = primaries.icc_colors(bytes(icc))
    if kind == "png" and (coded := _png_chunk(path, b"cICP")) is not None:  # it counts before all others
        colors = primaries.cicp_colors(coded[0], coded[1])
    elif icc is None and kind == "png":
        with PngImagePlugin.PngImageFile(path) as image:
            colors = primaries.png_colors(image.info)
    tag = "Interoperability InteroperabilityIndex"
    if icc is None and kind == "jpeg" and str(exif_tags(path).get(tag)) == "R03":
        # Adobe RGB, for which cameras embed no profile.
        colors = Colors(primaries.power(563.0 / 256.0), primaries.to_rec709(primaries.ADOBE_RGB))
    exif: Path | bytes = path
    if kind == "webp":  # where ExifRead finds none
        with WebPImagePlugin.WebPImageFile(path) as webp:
            exif = webp.info.get("exif") or b""

    def read() -> Any:
        pixels = file.read_image(0, 0, 0, min(spec.nchannels, 3), name)
        if pixels is None or file.has_error:
            raise ValueError(file.geterror() or "it is damaged")
        return pixels

    return Picture(kind, (spec.width, spec.height), name, colors, read, exif)


def _png_chunk(path: Path, name: bytes) -> bytes | None:
    """The content of a PNG's chunk before its pixels; None without it."""
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
            length = int.from_bytes(head[:4], "big")
            if head[4:] == name:
                return file.read(min(length, MOST_CHUNK))
            file.seek(length + 4, io.SEEK_CUR)
    return None


def _radiance_colors(path: Path) -> Colors:
    """What a Radiance file's header says of its values; OpenImageIO applies none of it."""
    with path.open("rb") as file:
        head, _, rest = file.read(65_536).partition(b"\n\n")
    if not rest.startswith(b"-Y"):
        raise ValueError("its rows are in an unusual order")
    scale, matrix = np.ones(3), None
    for line in head.split(b"\n"):
        name, _, value = line.partition(b"=")
        if name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise ValueError("its colors are CIE XYZ, not RGB")
        if name == b"PRIMARIES":
            matrix = primaries.to_rec709(np.array(value.split(), np.float64))
        elif name in (b"EXPOSURE", b"COLORCORR"):
            scale = scale / np.array(value.split(), np.float64)
    if scale.shape != (3,) or not ((scale > 1e-12) & (scale < 1e12)).all():
        raise ValueError("its exposure makes no sense")
    plain = matrix is None and (scale == 1.0).all()
    return Colors(None, None if plain else (np.eye(3) if matrix is None else matrix) * scale)


def _colors_of(path: Path, picture: Picture) -> np.ndarray:
    """Values (height, width, 3) as stored; grey ones are repeated."""
    pixels = stored_values(path, picture)
    return np.repeat(pixels[..., :1], 3, axis=-1) if pixels.shape[-1] < 3 else pixels[..., :3]


def _curve_table(picture: Picture) -> np.ndarray:
    """(levels, 3) linear value of each code."""
    codes = np.linspace(0.0, 1.0, np.iinfo(picture.type).max + 1)
    if picture.colors.curve is None:
        return np.repeat(srgb_decoded(codes)[:, None], 3, axis=1)
    return np.clip(picture.colors.curve(codes), 0.0, 1.0)


def _mapped(table: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Codes (..., 3) by a table (levels, 3)."""
    return np.stack([table[codes[..., channel], channel] for channel in range(3)], axis=-1)


def _png_ids(path: Path) -> np.ndarray:
    """Ids (height, width) int64 of an id image in PNG."""
    try:
        with PngImagePlugin.PngImageFile(path) as image:  # of palettes, OpenImageIO gives only the colours
            if image.mode == "P":
                return np.asarray(image).astype(np.int64)
            bits = {"1": 1, "L;2": 2, "L;4": 4}.get(str(image.tile[0].args), 8)
    except DAMAGE as error:
        raise unreadable(path, error) from None
    picture = open_picture(path)
    colors = stored_values(path, picture).astype(np.int64)
    if colors.shape[-1] < 3:
        return colors[..., 0] // (255 // (2**bits - 1))  # fewer bits than 8 are scaled
    if picture.type == "uint16":
        same = (colors % 257 == 0).all(axis=-1)
        red = colors[..., 0] if same.all() else _red(path, colors)
        return np.where(same, _packed(colors // 257), red)
    return _packed(colors)


def _packed(colors: np.ndarray) -> np.ndarray:
    return np.asarray((colors[..., 0] << 16) + (colors[..., 1] << 8) + colors[..., 2])


def _red(path: Path, colors: np.ndarray) -> np.ndarray:
    """The first channel of (height, width, channels), to which the others must have nothing to add."""
    red, others = colors[..., :1], colors[..., 1:]
    if others.any() and (others != red).any():
        remedy = "with one channel, or as PNG with colors of 8 bits"
        raise _no_ids(path, "has several values in each pixel, which are too many for an id", remedy)
    return np.asarray(red[..., 0])


def _no_ids(path: Path, fault: str, remedy: str) -> FiptError:
    return FiptError("mask-not-ids", f"{path} {fault}: it is no id image.", f"Save id images {remedy}.")
