# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of Radiance pictures (.hdr): RGBE pixels, run-length encoded or plain, rows from the top.

After the format's description in Radiance's reference manual ("Radiance file formats").
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..run.documents import read_limited
from ..run.shapes import MOST_SIDE

_HEADER_BYTES = 65_536  # at most


def read_size(path: Path) -> tuple[int, int]:
    """Width and height from the header.

    Raises:
        ValueError: it is no Radiance picture.
        OSError: the system's.
    """
    with path.open("rb") as file:
        width, height, _, _ = _header(file.read(_HEADER_BYTES))
    return width, height


def read(path: Path) -> np.ndarray:
    """Pixels (height, width, 3) float32, with the exposures of the header undone.

    Raises:
        ValueError: it is damaged.
        OSError: the system's.
    """
    data = read_limited(path, 1_000_000_000)  # 160 megapixels without compression have 640 MB
    width, height, start, exposure = _header(data)
    encoded = np.frombuffer(data, np.uint8, offset=start)
    if encoded[:3].tolist() == [2, 2, width >> 8] and 8 <= width < 32768:
        rgbe = _decode(encoded, width, height)
    elif len(encoded) >= 4 * width * height:
        rgbe = encoded[: 4 * width * height].reshape(height, width, 4)
    else:
        raise ValueError("it is cut off")
    scale = np.ldexp(np.float32(1.0), rgbe[..., 3].astype(np.int32) - 136)
    scale[rgbe[..., 3] == 0] = 0.0
    return (rgbe[..., :3].astype(np.float32) + 0.5) * scale[..., None] / np.float32(exposure)


def _header(data: bytes) -> tuple[int, int, int, float]:
    """Width, height, where the pixels start, and the product of all exposures."""
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise ValueError("it is no Radiance picture")
    match = re.search(rb"\n\n-Y (\d{1,6}) \+X (\d{1,6})\n", data[:_HEADER_BYTES])
    if match is None:
        raise ValueError("its header is damaged, or its rows are in an unusual order")
    lines = data[: match.start()].split(b"\n")
    if any(line.startswith(b"FORMAT=") and line.strip() != b"FORMAT=32-bit_rle_rgbe" for line in lines):
        raise ValueError("its colours are not RGB")
    exposure = 1.0
    for line in lines:
        if line.startswith(b"EXPOSURE="):
            exposure *= float(line[9:])
    width, height = int(match.group(2)), int(match.group(1))
    if not (0 < width <= MOST_SIDE and 0 < height <= MOST_SIDE and 1e-12 < exposure < 1e12):
        raise ValueError("its size or exposure makes no sense")
    return width, height, match.end(), exposure


def _decode(encoded: np.ndarray, width: int, height: int) -> np.ndarray:
    """Rows of four planes, each of runs (a length above 128 and a value) and of literals."""
    rows = np.empty((height, 4, width), np.uint8)
    position, data = 0, encoded.tobytes()
    for y in range(height):
        if data[position : position + 4] != bytes([2, 2, width >> 8, width & 255]):
            raise ValueError("a row is damaged")
        position += 4
        for plane in range(4):
            parts, filled = [], 0
            while filled < width:
                if position + 1 >= len(data):
                    raise ValueError("it is cut off")
                count = data[position]
                if count > 128:
                    count -= 128
                    parts.append(data[position + 1 : position + 2] * count)
                    position += 2
                else:
                    parts.append(data[position + 1 : position + 1 + count])
                    position += 1 + count
                filled += count
                if count == 0:
                    raise ValueError("a row is damaged")
            row = b"".join(parts)
            if len(row) != width:
                raise ValueError("a row is damaged")
            rows[y, plane] = np.frombuffer(row, np.uint8)
    return np.ascontiguousarray(np.moveaxis(rows, 1, 2))
