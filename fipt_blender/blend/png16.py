"""PNG files of 16 bits a channel, which Blender writes only with a scene's render settings.

Standard library and numpy only.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np


def encode_png(values: np.ndarray) -> bytes:
    """The content of a PNG file.

    Args:
        values: (H, W, 3), 0 to 1, bottom row first as in Blender; others are clipped.
    """
    height, width, _ = values.shape
    codes = np.round(np.clip(values[::-1], 0.0, 1.0) * 65535).astype(">u2")
    rows = codes.reshape(height, -1).view(np.uint8)
    filtered = np.empty((height, rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = 2  # each byte minus the one above it (PNG specification, 9.2)
    filtered[:, 1:] = rows
    filtered[1:, 1:] -= rows[:-1]
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def decode_srgb(values: np.ndarray) -> np.ndarray:
    """The inverse of `encode_srgb`, of values from 0 to 1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(values.dtype)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Values by sRGB's transfer function (IEC 61966-2-1), clipped to 0 to 1."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
