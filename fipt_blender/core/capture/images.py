# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files in and out: linear radiance (EXR), id images (EXR or PNG). First row is the top.

OpenEXR reads and writes EXR; Pillow reads PNG masks.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image, UnidentifiedImageError

from ..job.errors import FiptError
from ..job.runfolder import atomic_path

EXR_SUFFIX = ".exr"
MASK_SUFFIXES = (".exr", ".png")
HALF_MAX = 65504.0
REC709 = np.array([0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290])
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
MAX_ID = 2**24 - 1  # colour masks end here, and 32-bit floats hold all of them exactly


def read_size(path: Path) -> tuple[int, int]:
    """Width and height of an EXR or PNG image in pixels, from its header only.

    Raises:
        FiptError: ``image-missing`` or ``image-unreadable``.
    """
    if path.suffix.lower() != EXR_SUFFIX:
        return _open_with_pillow(path).size
    header = _open_exr(path, header_only=True).header()
    low, high = header["displayWindow"]
    return int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1


def is_rec709(path: Path) -> bool:
    """Whether an EXR's values are Rec.709 as stored, so that any program reads them as `read_radiance` does.

    Raises:
        FiptError: ``image-missing`` or ``image-unreadable``.
    """
    return _other_primaries(_open_exr(path, header_only=True).header()) is None


def read_radiance(path: Path) -> np.ndarray:
    """Scene-linear radiance of an EXR image.

    Reads R, G, B, or one channel Y, of the first layer that has them, half or float; an image whose data
    window differs from its display window is cut or padded with black to the display window. Other
    primaries that the header declares are converted to Rec.709.

    Returns:
        (height, width, 3) float32, units as stored.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable``, ``image-ldr`` for other formats than EXR,
            ``image-channels`` where it has no colour.
    """
    if path.suffix.lower() != EXR_SUFFIX:
        if not path.is_file():
            raise _missing(path)
        raise FiptError(
            "image-ldr",
            f"{path} is a {path.suffix or 'nameless'} file; scene-linear HDR radiance is needed.",
            "Merge the exposures and save OpenEXR (.exr); 8-bit photographs and .hdr files can't be used.",
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
        primaries = _other_primaries(header)
        return pixels if primaries is None else _to_rec709(path, pixels, primaries)
    raise FiptError(
        "image-channels",
        f"{path} has no R, G, B or Y channels.",
        "Save the photograph as an EXR with R, G and B channels.",
    )


def read_ids(path: Path) -> np.ndarray:
    """Ids of an id image.

    EXR: the channel R, Y or else the first, holding whole numbers. PNG: palette indices or grey values of
    8 or 16 bit; colour masks give each colour the id ``red * 65536 + green * 256 + blue``.

    Returns:
        (height, width) int32.

    Raises:
        FiptError: ``image-missing``, ``image-unreadable``, ``mask-not-ids`` where values are no ids.
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
            f"{path} holds fractions: it is no image of ids.",
            "Save id images without antialiasing, one whole number a part.",
        )
    if np.abs(values).max(initial=0.0) > MAX_ID:
        raise FiptError("mask-not-ids", f"{path} holds ids above {MAX_ID}.", "Use smaller ids.")
    return np.round(values).astype(np.int32)


def write_exr(path: Path, array: np.ndarray, half: bool = False) -> None:
    """Write an image as EXR, whole or not at all.

    Args:
        path: the file; its folder is made where missing.
        array: (height, width, 3) as R, G, B, or (height, width) as Y; converted to float.
        half: 16-bit values, at most 65504, instead of 32-bit.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    values = np.asarray(array)
    if half:
        values = np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)
    else:
        values = values.astype(np.float32)
    planes = {"Y": values} if values.ndim == 2 else dict(zip("RGB", np.moveaxis(values, -1, 0), strict=True))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # Through memory, because OpenEXR's own writing loses the system's reason for a failure.
    buffer = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def _missing(path: Path) -> FiptError:
    return FiptError("image-missing", f"The image {path} does not exist.", "Restore it, or correct its path.")


def _unreadable(path: Path, reason: object) -> FiptError:
    return FiptError("image-unreadable", f"{path} can't be read ({reason}).", "Export the image again.")


def _open_exr(path: Path, header_only: bool = False) -> OpenEXR.File:
    if not path.is_file():
        raise _missing(path)
    try:
        file = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except (RuntimeError, ValueError, TypeError) as error:
        raise _unreadable(path, error) from None
    if not file.parts:  # OpenEXR only prints a warning where pixels are cut off
        raise _unreadable(path, "the file is cut off or damaged")
    return file


def _colour_channels(names: list[str]) -> list[str] | None:
    """The three colour channels, or one luminance channel, of the first layer that has them."""
    by_layer: dict[str, dict[str, str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        by_layer.setdefault(layer, {})[channel.upper()] = name
    for wanted in ("RGB", "Y"):
        for layer in sorted(by_layer):  # the layer without a name sorts first
            if all(channel in by_layer[layer] for channel in wanted):
                return [by_layer[layer][channel] for channel in wanted]
    return None


def _other_primaries(header: dict[str, Any]) -> np.ndarray | None:
    """The header's chromaticities (8,) where it declares other ones than Rec.709."""
    if "chromaticities" not in header:
        return None
    values = np.asarray(header["chromaticities"], np.float64)
    return None if np.abs(values - REC709).max() < 1e-3 else values  # writers round them differently


def _xyz_from_rgb(chromaticities: np.ndarray) -> np.ndarray:
    """(3, 3) to CIE XYZ from linear RGB; chromaticities are x, y of red, green, blue and white."""
    x, y = chromaticities.reshape(4, 2).T
    xyz = np.stack([x / y, np.ones(4), (1.0 - x - y) / y])  # one column each, at luminance 1
    return xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3])


def _to_rec709(path: Path, pixels: np.ndarray, chromaticities: np.ndarray) -> np.ndarray:
    """Pixels (..., 3) float32 from the given primaries to Rec.709, white to white (Bradford)."""
    try:
        source, target = _xyz_from_rgb(chromaticities), _xyz_from_rgb(REC709)
        adapted = (BRADFORD @ target.sum(axis=1)) / (BRADFORD @ source.sum(axis=1))
        adaptation = np.linalg.solve(BRADFORD, adapted[:, None] * BRADFORD)
        matrix = np.linalg.solve(target, adaptation @ source)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise _unreadable(path, f"its chromaticities are impossible: {error}") from None
    return pixels @ matrix.T.astype(np.float32)


def _display_plane(path: Path, header: dict[str, Any], channel: OpenEXR.Channel) -> np.ndarray:
    """One channel (height, width) on the display window."""
    if channel.xSampling != 1 or channel.ySampling != 1:
        raise _unreadable(path, f"channel {channel.name} is subsampled")
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


def _open_with_pillow(path: Path) -> Image.Image:
    if not path.is_file():
        raise _missing(path)
    try:
        return Image.open(path)
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None


def _png_ids(path: Path) -> np.ndarray:
    image = _open_with_pillow(path)
    try:
        values = np.asarray(image)
    except (OSError, ValueError, SyntaxError) as error:
        raise _unreadable(path, error) from None
    if path.suffix.lower() != ".png":
        raise FiptError(
            "mask-not-ids",
            f"{path} is no PNG or EXR: lossy formats change ids.",
            "Save id images as PNG or EXR.",
        )
    values = values.astype(np.int32)
    if values.ndim == 2:
        return values
    if values.shape[-1] == 2:  # grey with alpha
        return values[..., 0]
    return (values[..., 0] << 16) + (values[..., 1] << 8) + values[..., 2]
