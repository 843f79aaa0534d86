"""What a Blender of its own does for `core.capture.mesh_file`: reads a mesh file and writes its arrays."""

from __future__ import annotations

import json
import os
import re
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ..room.mesh_arrays import corner_vertices, triangle_loops, vertex_positions
from .mesh_import import import_meshes

# Coordinates beyond this are those of a map: in the single precision of Blender's meshes, their last places
# are lost.
FAR = 1.0e4
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}


def near_origin(path: Path, copy: Path) -> tuple[Path, np.ndarray]:
    """The file, or a copy of an OBJ or PLY file in map coordinates near the origin; and (3,) what it lacks.

    Args:
        copy: where it is written, without its suffix.
    """
    move = {".obj": _moved_obj, ".ply": _moved_ply}.get(path.suffix.lower())
    moved = None if move is None else move(path.read_bytes())
    if moved is None:
        return path, np.zeros(3)
    copy = copy.with_suffix(path.suffix)
    copy.write_bytes(moved[0])
    return copy, moved[1]


def _moved_obj(data: bytes) -> tuple[bytes, np.ndarray] | None:
    """An OBJ file less the whole part of its first vertex, and that; None for one that is not far."""
    first = re.search(rb"^v[ \t].*", data, re.MULTILINE)
    offset = np.round(np.array(first[0].split()[1:4] if first else [0.0] * 3, float))
    if not np.abs(offset).max() > FAR:
        return None
    lines = data.split(b"\n")
    for index, line in enumerate(lines):
        if line.startswith((b"v ", b"v\t")):
            words = line.split()
            lines[index] = b" ".join([b"v", *_less(words[1:4], offset), *words[4:]])
    return b"\n".join(lines), offset


def _moved_ply(data: bytes) -> tuple[bytes, np.ndarray] | None:
    """As `_moved_obj`, of a PLY file that begins with its vertices."""
    header = re.match(
        rb"ply\s.*?element vertex (\d+)\r?\n(.*?)(element.*?)?end_header\r?\n", data[:65536], re.DOTALL
    )
    if header is None:
        return None
    count, rest = int(header[1]), memoryview(data)[header.end() :]
    kinds = {
        name.decode(): _TYPES[kind.decode()] for kind, name in re.findall(rb"property (\w+) (\w+)", header[2])
    }
    if b"format ascii" in header[0]:
        place = [list(kinds).index(axis) for axis in "xyz"]
        first = data[header.end() :].partition(b"\n")[0].split()
        offset = np.round([float(first[axis]) for axis in place])
        if not np.abs(offset).max() > FAR:
            return None
        lines = data[header.end() :].split(b"\n", count)
        rows = [line.split() for line in lines[:count]]
        for row in rows:
            for index, word in zip(place, _less([row[index] for index in place], offset), strict=True):
                row[index] = word
        return header[0] + b"\n".join([*map(b" ".join, rows), *lines[count:]]), offset
    order = "<" if b"little_endian" in header[0] else ">"
    table = np.frombuffer(rest, [(name, order + kind) for name, kind in kinds.items()], count)
    offset = np.round([float(table[axis][0]) for axis in "xyz"])
    if not np.abs(offset).max() > FAR:
        return None
    table = table.copy()
    for axis, less in zip("xyz", offset, strict=True):
        table[axis] -= less
    return header[0] + table.tobytes() + rest[table.nbytes :], offset


def _less(words: list[bytes], offset: np.ndarray) -> list[bytes]:
    return [repr(float(word) - less).encode() for word, less in zip(words, offset.tolist(), strict=True)]


def read(path: Path, arrays: Path) -> None:
    """Write vertices (V, 3) float64 and triangles (T, 3) int64 of a mesh file to a .npz file."""
    vertices, triangles, count = [], [], 0
    try:
        path, offset = near_origin(path, arrays)
    except (ValueError, IndexError, KeyError):  # the importer tells what is wrong
        offset = np.zeros(3)
    for name in import_meshes(path, np.eye(4)):
        mesh = bpy.data.objects[name].data
        corners = corner_vertices(mesh)
        if corners.min() < 0 or corners.max() >= len(mesh.vertices):
            raise FiptError("mesh-unreadable.read", path=path)
        vertices.append(vertex_positions(mesh) + offset)
        triangles.append(corners[triangle_loops(mesh, False)[0]].astype(np.int64) + count)
        count += len(mesh.vertices)
    np.savez(arrays, vertices=np.concatenate(vertices), triangles=np.concatenate(triangles))


def main() -> None:
    """Read the file of the first argument; errors are written beside the second one's."""
    path, arrays = Path(sys.argv[1]), Path(sys.argv[2])
    status = 0
    try:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True, load_ui=False)
        read(path, arrays)
    except FiptError as error:
        problem = [error.code, error.text, error.remedy]
        arrays.with_suffix(".json").write_text(json.dumps(problem), encoding="utf-8")
    except Exception:
        traceback.print_exc()
        status = 1
    sys.stderr.flush()
    os._exit(status)  # Blender would go on running, and as a module it can hang at exit


if __name__ == "__main__":
    main()
