# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and triangles of OBJ, PLY and GLB files, all that aligning a mesh needs of it.

Every fault of a file becomes one error, and nothing is allocated that the file does not hold.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..run.documents import read_limited
from ..run.errors import FiptError
from ..run.shapes import FARTHEST_UNITS
from .glb_file import read_glb
from .ply_header import Element, read_header


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int64 of an OBJ, PLY or GLB file; point clouds have none.

    Raises:
        FiptError: ``mesh-missing``, ``mesh-format`` or ``mesh-unreadable``.
    """
    readers = {".obj": _read_obj, ".ply": _read_ply, ".glb": read_glb}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise FiptError(
            "mesh-format",
            f"Cameras can't be aligned to {path.suffix or 'nameless'} files ({path}).",
            "Export it as OBJ, PLY or GLB, or import it and use Align by Points in the panel Alignment.",
        )
    if not path.is_file():
        raise FiptError("mesh-missing", f"The mesh {path} does not exist.", "Correct the path.")
    try:
        vertices, triangles = reader(read_limited(path, 4_000_000_000))
        wrong = int((~(np.abs(vertices) <= FARTHEST_UNITS)).any(axis=1).sum())
        if wrong:
            raise ValueError(f"{wrong} of {len(vertices)} vertices are not finite or impossibly far away")
        if len(triangles) and not (0 <= triangles.min() and triangles.max() < len(vertices)):
            raise ValueError("a face has a vertex that is not there")
    except (OSError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise FiptError(
            "mesh-unreadable", f"{path} can't be read ({error}).", "Export the mesh again."
        ) from None
    return vertices, triangles


def _read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    positions: list[list[bytes]] = []
    faces: list[list[int]] = []
    for line in data.replace(b"\\\n", b" ").split(b"\n"):
        if line.startswith(b"v "):
            positions.append(line.split(maxsplit=4)[1:4])
        elif line.startswith(b"f "):
            corners = [int(word.partition(b"/")[0]) for word in line.split()[1:]]
            corners = [corner - 1 if corner > 0 else len(positions) + corner for corner in corners]
            faces += [[corners[0], *corners[i : i + 2]] for i in range(1, len(corners) - 1)]
    vertices = np.array(positions, np.float64).reshape(-1, 3)
    return vertices, np.array(faces, np.int64).reshape(-1, 3)


def _read_ply(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    header = read_header(data[:1_000_000])
    vertices, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    content = data[header.size :]
    body = _BinaryBody(content, header.order) if header.order else _AsciiBody(content)
    for element in header.elements:
        columns = body.read(element)
        if element.name == "vertex":
            vertices = np.stack([np.asarray(columns[axis], np.float64) for axis in "xyz"], axis=1)
        elif element.name == "face":
            corners = next((entry.name for entry in element.properties if element.is_index(entry)), None)
            triangles = _fans([] if corners is None else columns[corners])
    return vertices, triangles


class _AsciiBody:
    """The content of a PLY file in words."""

    def __init__(self, data: bytes) -> None:
        self._lines = iter(data.split(b"\n"))

    def read(self, element: Element) -> dict[str, list]:
        """Values of each property; lists for list properties."""
        columns: dict[str, list] = {entry.name: [] for entry in element.properties}
        for _ in range(element.count):
            line = next(self._lines, None)
            if line is None:
                raise ValueError("it is cut off")
            words, place = line.split(), 0
            for entry in element.properties:
                if entry.count_type:
                    count = int(words[place])
                    columns[entry.name].append([int(word) for word in words[place + 1 : place + 1 + count]])
                    place += count
                else:
                    columns[entry.name].append(float(words[place]))
                place += 1
        return columns


class _BinaryBody:
    """The content of a PLY file in bytes."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._place, self._order = data, 0, order

    def read(self, element: Element) -> dict[str, np.ndarray]:
        """Values of each property; of a list property, those of triangles (count, 3)."""
        lists = [entry for entry in element.properties if entry.count_type]
        if len(lists) > 1:
            raise ValueError(f"its element {element.name} has several lists")
        kinds: list[tuple] = []
        for entry in element.properties:
            kinds += [("length", self._order + entry.count_type)] if entry.count_type else []
            kinds.append((entry.name, self._order + entry.type, (3,) if entry.count_type else ()))
        records = self._take(np.dtype(kinds), element.count)
        if lists and (records["length"] != 3).any():
            raise ValueError("it has faces that are no triangles; triangulate it")
        return {entry.name: records[entry.name] for entry in element.properties}

    def _take(self, kind: np.dtype, count: int) -> np.ndarray:
        if self._place + kind.itemsize * count > len(self._data):
            raise ValueError("it is cut off, or has faces that are no triangles")
        records = np.frombuffer(self._data, kind, count, self._place)
        self._place += kind.itemsize * count
        return records


def _fans(lists: list | np.ndarray) -> np.ndarray:
    """Triangles (T, 3) of polygons."""
    if isinstance(lists, np.ndarray):
        return lists.astype(np.int64)
    triangles = [
        [polygon[0], polygon[i], polygon[i + 1]] for polygon in lists for i in range(1, len(polygon) - 1)
    ]
    return np.array(triangles, np.int64).reshape(-1, 3)
