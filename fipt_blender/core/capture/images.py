# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing image files: linear radiance (EXR), id images (EXR or PNG). The first row is the top.

OpenEXR reads and writes EXR; Pillow reads PNG masks, and photographs that are not HDR (:mod:`.encoded`).
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image, PngImagePlugin

from ..run.errors import FiptError
from ..run.runfolder import atomic_path
from .encoded import check_pixels, is_encoded, missing, pillow_size, read_encoded, unreadable

EXR_SUFFIX = ".exr"
MASK_SUFFIXES = (".exr", ".png")
HALF_MAX = float(np.finfo(np.float16).max)
JPEG_QUALITY = 95  # an error of about one of 255 steps
REC709 = np.array([0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290])
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
MAX_PNG_ID = 2**16 - 1  # 16 bits
MAX_ID = 2**24 - 1  # highest id of a colour mask; 32-bit floats represent all of them exactly


def read_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of an EXR or PNG image, from its header only.

    Raises:
        FiptError: ``image-missing`` or ``image-unreadable``.
    """
    if path.suffix.lower() != EXR_SUFFIX:
        return pillow_size(path)
    return _window_size(_open_exr(path, header_only=True).header()["displayWindow"])


def is_rec709(path: Path) -> bool:
    """Whether an image's values are stored in Rec.709, so that `read_radiance` does not convert them.

    Raises:
        FiptError: ``image-missing`` or ``image-unreadable``.
    """
    return is_encoded(path) or _other_primaries(path, _open_exr(path, header_only=True).header()) is None


def read_radiance(path: Path) -> np.ndarray:
    """Scene-linear radiance of an EXR image; of JPEG, PNG and TIFF the values by sRGB's curve.

    Reads R, G, B, or one channel Y, of the first layer that has them, half or float. An image whose data
    window differs from its display window is cropped or padded with black to the display window. If the
    header declares other primaries, values are converted to Rec.709.

    Returns:
        (height, width, 3) float32, units as stored.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable``, ``image-format`` for other formats,
            ``image-channels`` where it has none of these channels.
    """
    if is_encoded(path):
        return read_encoded(path)
    if path.suffix.lower() != EXR_SUFFIX:
        if not path.is_file():
            raise missing(path)
        raise FiptError(
            "image-format",
            f"{path} is no OpenEXR, JPEG, PNG or TIFF file.",
            "Save OpenEXR (.exr) files, or prepare the photographs (section Photographs), which reads RAW,"
            " HEIC and .hdr files, too.",
        )
    file = _open_exr(path)
    for index in range(len(file.parts)):
        channels = file.channels(index)
        names = _colour_channels(list(channels))
        if names is None:
            continue
        header = file.header(index)
        planes = [_display_plane(path, header, channels[name]) for name in names]
        if len(planes) == 1:
            return np.repeat(planes[0].astype(np.float32)[..., None], 3, axis=-1)
        pixels = np.stack(planes, axis=-1).astype(np.float32)
        primaries = _other_primaries(path, header)
        return pixels if primaries is None else _to_rec709(path, pixels, primaries)
    raise FiptError(
        "image-channels",
        f"{path} has no R, G, B or Y channels.",
        "Save the photograph as an EXR with R, G and B channels.",
    )


def read_ids(path: Path) -> np.ndarray:
    """Ids of an id image.

    EXR: integer values of the channel R, else Y, else the first. PNG: palette indices or grey values of
    8 or 16 bit; in colour masks, each colour has the id ``red * 65536 + green * 256 + blue``.

    Returns:
        (height, width) int32.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable``, ``mask-not-ids`` where values are not ids.
    """
    if path.suffix.lower() != EXR_SUFFIX:
        return _png_ids(path)
    file = _open_exr(path)
    channels = file.channels(0)
    colour = _colour_channels(list(channels))
    name = colour[0] if colour else sorted(channels)[0]
    values = _display_plane(path, file.header(0), channels[name]).astype(np.float64)
    if not np.isfinite(values).all() or np.abs(values - np.round(values)).max(initial=0.0) > 1e-3:
        raise FiptError(
            "mask-not-ids",
            f"{path} contains fractions: it is not an id image.",
            "Save id images without anti-aliasing, with one integer per part.",
        )
    if np.abs(values).max(initial=0.0) > MAX_ID:
        raise FiptError("mask-not-ids", f"{path} contains ids above {MAX_ID}.", "Use smaller ids.")
    return np.round(values).astype(np.int32)


def write_exr(path: Path, array: np.ndarray, half: bool = False, lossy: bool = False) -> None:
    """Write an image as EXR, completely or not at all.

    Args:
        path: the file; its folder is created if missing.
        array: (height, width, 3) as R, G, B, or (height, width) as Y; converted to float.
        half: 16-bit values, clamped to ±65504, instead of 32-bit.
        lossy: compressed to a quarter, for pictures that are only looked at.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    values = np.asarray(array)
    if half:
        values = np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)
    else:
        values = values.astype(np.float32)
    planes = {"Y": values} if values.ndim == 2 else dict(zip("RGB", np.moveaxis(values, -1, 0), strict=True))
    compression = OpenEXR.DWAA_COMPRESSION if lossy else OpenEXR.ZIP_COMPRESSION
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    # Written through memory, because OpenEXR does not report the system's reason for a failure.
    buffer = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def write_jpeg(path: Path, values: np.ndarray) -> None:
    """Write values (height, width, 3) from 0 to 1 as JPEG with all colour samples, completely or not at all.

    The error is about one of 255 steps (`JPEG_QUALITY`).

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    codes = np.clip(values * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(codes).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
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


def _window_size(window: Any) -> tuple[int, int]:
    """Width and height of an EXR's data or display window."""
    low, high = window
    return int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1


def _check_header(path: Path, header: dict[str, Any]) -> None:
    """Check the sizes that an EXR's header announces, before any pixel is read."""
    width, height = _window_size(header["displayWindow"])
    check_pixels(path, width, height)
    data_width, data_height = _window_size(header["dataWindow"])
    check_pixels(path, data_width, data_height)
    if width * height > 16_000_000 and data_width * data_height < width * height / 16:
        raise unreadable(path, f"{width} x {height} pixels, of which {data_width} x {data_height} are stored")


def _open_exr(path: Path, header_only: bool = False) -> OpenEXR.File:
    """Open an EXR after a look at its header.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable`` or ``image-too-large``.
    """
    header = _exr_file(path, header_only=True)
    for index in range(len(header.parts)):
        _check_header(path, header.header(index))
    return header if header_only else _exr_file(path, header_only=False)


def _exr_file(path: Path, header_only: bool) -> OpenEXR.File:
    if not path.is_file():
        raise missing(path)
    try:
        file = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError) as error:
        raise unreadable(path, error) from None
    if not file.parts:  # OpenEXR only prints a warning where pixels are missing
        raise unreadable(path, "the file is truncated or damaged")
    return file


def _colour_channels(names: list[str]) -> list[str] | None:
    """The three colour channels, or one luminance channel, of the first layer that has them."""
    by_layer: dict[str, dict[str, str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        by_layer.setdefault(layer, {})[channel.upper()] = name
    for wanted in ("RGB", "Y"):
        for layer in sorted(by_layer):  # the unnamed layer sorts first
            if all(channel in by_layer[layer] for channel in wanted):
                return [by_layer[layer][channel] for channel in wanted]
    return None


def _other_primaries(path: Path, header: dict[str, Any]) -> np.ndarray | None:
    """(8,) chromaticities that the header declares, None where they are Rec.709 or not declared."""
    if "chromaticities" not in header:
        return None
    try:
        values = np.asarray(header["chromaticities"], np.float64).reshape(8)
    except (TypeError, ValueError):
        raise unreadable(path, "its chromaticities are not eight numbers") from None
    return None if np.abs(values - REC709).max() < 1e-3 else values  # programs round them differently


def _xyz_from_rgb(chromaticities: np.ndarray) -> np.ndarray:
    """(3, 3) matrix from linear RGB to CIE XYZ; chromaticities are x, y of red, green, blue and white."""
    x, y = chromaticities.reshape(4, 2).T
    xyz = np.stack([x / y, np.ones(4), (1.0 - x - y) / y])  # one column each, at luminance 1
    return xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3])


def _to_rec709(path: Path, pixels: np.ndarray, chromaticities: np.ndarray) -> np.ndarray:
    """Convert pixels (..., 3) float32 from the given primaries to Rec.709 (Bradford white adaptation)."""
    try:
        source, target = _xyz_from_rgb(chromaticities), _xyz_from_rgb(REC709)
        adapted = (BRADFORD @ target.sum(axis=1)) / (BRADFORD @ source.sum(axis=1))
        adaptation = np.linalg.solve(BRADFORD, adapted[:, None] * BRADFORD)
        matrix = np.linalg.solve(target, adaptation @ source)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise unreadable(path, f"its chromaticities are invalid: {error}") from None
    return pixels @ matrix.T.astype(np.float32)


def _display_plane(path: Path, header: dict[str, Any], channel: OpenEXR.Channel) -> np.ndarray:
    """One channel (height, width) on the display window."""
    if channel.xSampling != 1 or channel.ySampling != 1:
        raise unreadable(path, f"channel {channel.name} is subsampled")
    pixels = np.asarray(channel.pixels)
    data_low, data_high = header["dataWindow"]
    low, high = header["displayWindow"]
    if np.array_equal(data_low, low) and np.array_equal(data_high, high):
        return pixels
    plane = np.zeros((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), pixels.dtype)
    x0, y0 = (int(v) for v in np.maximum(data_low, low))
    x1, y1 = (int(v) for v in np.minimum(data_high, high) + 1)
    if x1 > x0 and y1 > y0:
        plane[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]] = pixels[
            y0 - data_low[1] : y1 - data_low[1], x0 - data_low[0] : x1 - data_low[0]
        ]
    return plane


def _png_ids(path: Path) -> np.ndarray:
    if path.suffix.lower() != ".png":
        raise FiptError(
            "mask-not-ids",
            f"{path} is not a PNG or EXR file: lossy formats change ids.",
            "Save id images as PNG or EXR.",
        )
    if not path.is_file():
        raise missing(path)
    try:
        # As PNG whatever its content is: for some formats Pillow starts other programs. Not through
        # Image.open, whose limit refuses legitimate masks.
        image = PngImagePlugin.PngImageFile(path)
        check_pixels(path, *image.size)
        values = np.asarray(image)
    except (OSError, ValueError, SyntaxError, struct.error, zlib.error) as error:
        raise unreadable(path, error) from None
    values = values.astype(np.int32)
    if values.ndim == 2:
        return values
    if values.shape[-1] == 2:  # grey with alpha
        return values[..., 0]
    return (values[..., 0] << 16) + (values[..., 1] << 8) + values[..., 2]
