# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes images of several layers as one OpenEXR file, which Blender's Python can't.

Source: "OpenEXR File Layout" (openexr.com): a single part of scan lines with ZIP compression, channels sorted
by their names "LAYER.CHANNEL". Blender, Nuke and Fusion read them as layers.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ...core.run.runfolder import atomic_path

_MAGIC, _VERSION = 20000630, 2
_LONG_NAMES = 0x400  # names of more than 31 characters
_HALF, _FLOAT = 1, 2  # types of channels
_ZIP, _LINES = 3, 16  # the compression, and how many lines it compresses at a time
_LEVEL = 4  # of zlib: OpenEXR's default
_LARGEST_HALF = 65504.0
_MOST_HEADER = 4096  # bytes


def write_layers(path: Path, layers: Mapping[str, np.ndarray], exact: tuple[str, ...] = ()) -> None:
    """Write layers atomically; first row at the top.

    Args:
        path: of the file.
        layers: (H, W), (H, W, 3) or (H, W, 4) of one size, by name; "" is what simple programs show.
            Colours are linear Rec.709, with premultiplied alpha; a layer of one channel has the channel Z.
        exact: layers that are written as 32-bit floats instead of halves.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    channels = dict(sorted(_channels(layers, exact)))
    height, width = next(iter(channels.values())).shape
    header = _header(channels, width, height)
    count = -(-height // _LINES)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(header)
        file.write(bytes(8 * count))
        offsets = []
        for top in range(0, height, _LINES):
            offsets.append(file.tell())
            lines = range(top, min(top + _LINES, height))
            block = _compressed(b"".join(rows[y].tobytes() for y in lines for rows in channels.values()))
            file.write(struct.pack("<ii", top, len(block)))
            file.write(block)
        file.seek(len(header))
        file.write(struct.pack(f"<{count}Q", *offsets))


def read_size(path: Path) -> tuple[int, int]:
    """Columns and rows of a file that `write_layers` wrote. Blender doesn't say them of files with layers."""
    with open(path, "rb") as file:
        head = file.read(_MOST_HEADER)
    window = head.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    left, top, right, bottom = struct.unpack_from("<4i", head, window)
    return right - left + 1, bottom - top + 1


def _channels(layers: Mapping[str, np.ndarray], exact: tuple[str, ...]) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values (H, W) of the channels."""
    for layer, pixels in layers.items():
        values = pixels.astype("<f4") if layer in exact else np.minimum(pixels, _LARGEST_HALF).astype("<f2")
        prefix = f"{layer}." if layer else ""
        if values.ndim == 2:
            yield f"{prefix}Z", values
            continue
        for index, name in enumerate("RGBA"[: values.shape[2]]):
            yield prefix + name, values[..., index]


def _header(channels: Mapping[str, np.ndarray], width: int, height: int) -> bytes:
    kinds = {"<f2": _HALF, "<f4": _FLOAT}
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iiii", kinds[rows.dtype.str], 0, 1, 1)
        for name, rows in channels.items()
    )
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    attributes = [
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", bytes([_ZIP])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    flags = _LONG_NAMES if max(map(len, channels)) > 31 else 0
    parts = [struct.pack("<ii", _MAGIC, _VERSION | flags)]
    for name, kind, value in attributes:
        parts += [name.encode(), b"\0", kind.encode(), b"\0", struct.pack("<i", len(value)), value]
    return b"".join([*parts, b"\0"])


def _compressed(raw: bytes) -> bytes:
    """A block of lines: low and high bytes apart, differences, zlib; as it is if that is smaller."""
    values = np.frombuffer(raw, np.uint8)
    apart = np.concatenate([values[0::2], values[1::2]])
    apart[1:] -= apart[:-1] + np.uint8(128)  # modulo 256
    block = zlib.compress(apart.tobytes(), _LEVEL)
    return block if len(block) < len(raw) else raw
