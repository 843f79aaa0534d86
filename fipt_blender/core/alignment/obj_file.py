# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and polygons of OBJ files, for the engine and for the check before Blender's importer."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .polygons import Polygons


def read_obj(path: Path) -> Polygons:
    """Read an OBJ file and check its coordinates and indices.

    Raises:
        OSError: the system's.
        ValueError: what is wrong with it.
    """
    positions, corners, lengths = array("d"), array("q"), array("q")
    with open(path, "rb") as file:
        for words in map(bytes.split, _joined(file)):
            if words[:1] == [b"v"]:
                positions.extend(_position(words[1:4]))
            elif words[:1] == [b"f"]:
                indices = [_whole(word.partition(b"/")[0]) for word in words[1:]]
                count = len(positions) // 3
                # Negative ones count back from the last vertex so far; there is no vertex 0.
                corners.extend(index - 1 if index >= 0 else max(count + index, -1) for index in indices)
                lengths.append(len(indices))
    vertices = np.array(positions, np.float64).reshape(-1, 3)
    polygons = Polygons(vertices, np.array(corners, np.int64), np.array(lengths, np.int64))
    polygons.check(first=1)
    return polygons


def _position(words: list[bytes]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    return values if len(values) == 3 else [np.nan] * 3


def _whole(word: bytes) -> int:
    try:
        return min(int(word), 1 << 62)
    except ValueError:
        raise ValueError(f"'{word[:60].decode('latin-1')}' is no whole number") from None


def _joined(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Lines without comments; those that end with a backslash joined with the next one."""
    for line in lines:
        while line.rstrip(b"\r\n").endswith(b"\\"):
            line = line.rstrip(b"\r\n")[:-1] + b" " + next(lines, b"")
        yield line.partition(b"#")[0]
