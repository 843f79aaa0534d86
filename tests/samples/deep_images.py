# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and TIFF files with 16 bits in each of three or four channels, which Pillow does not write."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np


def write_deep_png(path: Path, codes: np.ndarray) -> Path:
    """Write codes (height, width, 3 or 4) uint16; every second row as differences to the one above."""
    height, width, channels = codes.shape
    rows = codes.astype(">u2").view(np.uint8).reshape(height, -1)
    above = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    odd = (np.arange(height) % 2 == 1)[:, None]
    filtered = np.where(odd, rows - above, rows)
    marks = np.where(odd, 2, 0).astype(np.uint8)
    header = struct.pack(">IIBBBBB", width, height, 16, {3: 2, 4: 6}[channels], 0, 0, 0)
    data = zlib.compress(np.concatenate([marks, filtered], axis=1).tobytes())
    chunks = [(b"IHDR", header), (b"IDAT", data), (b"IEND", b"")]
    blocks = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(blocks))
    return path


def write_deep_tiff(path: Path, codes: np.ndarray, order: str, packed: bool) -> Path:
    """Write codes (height, width, 3 or 4) uint16 as one strip.

    Args:
        order: of the bytes, "<" or ">".
        packed: whether the strip is deflated.
    """
    height, width, channels = codes.shape
    data = codes.astype(f"{order}u2").tobytes()
    data = zlib.compress(data) if packed else data
    tags = 9 + (channels == 4)
    depths = 8 + 2 + 12 * tags + 4  # the offset of what follows the directory
    entries = [(256, width), (257, height), (258, None), (259, 8 if packed else 1), (262, 2)]
    entries += [(273, depths + 2 * channels), (277, channels), (278, height), (279, len(data))]
    entries += [(338, 2)] if channels == 4 else []
    body = b"".join(
        struct.pack(f"{order}HHII", tag, 3, channels, depths)
        if value is None
        else struct.pack(f"{order}HHII", tag, 4, 1, value)
        for tag, value in entries
    )
    start = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HIH", 42, 8, tags)
    path.write_bytes(start + body + struct.pack(f"{order}I{channels}H", 0, *[16] * channels) + data)
    return path
