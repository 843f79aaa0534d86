# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and triangles of mesh files, all that aligning and simplifying a mesh need of it.

Every fault of a file becomes one error, and nothing is allocated that the file does not hold.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..run.documents import check_size, read_limited
from ..run.errors import FiptError
from .gltf_file import MOST_BYTES, load_scene, read_gltf
from .obj_file import read_obj
from .ply_file import read_ply
from .polygons import Polygons


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int64 of a mesh file; point clouds have none.

    They are in the file's own coordinates, with its nodes placed; mirrored nodes keep their outer sides.

    Args:
        path: OBJ, PLY, STL, glTF or GLB file.

    Raises:
        FiptError: ``mesh-missing``, ``mesh-format`` or ``mesh-unreadable``.
    """
    suffix = path.suffix.lower()
    readers: dict[str, Callable[[Path], Any]] = {
        ".obj": read_obj,
        ".ply": read_ply,
        ".stl": _read_stl,
        ".gltf": read_gltf,
        ".glb": read_gltf,
    }
    if suffix not in readers:
        raise FiptError(
            "mesh-format",
            f"{suffix or 'nameless'} files can't be simplified when they are imported ({path}).",
            "Export it as OBJ, PLY, STL or glTF, or import it and use Simplify Room.",
        )
    if not path.is_file():
        raise FiptError("mesh-missing", f"The mesh {path} does not exist.", "Correct the path.")
    try:
        check_size(path, MOST_BYTES)
        found = readers[suffix](path)
        if isinstance(found, Polygons):
            return found.vertices, found.triangles()
        vertices, triangles = found
        Polygons(vertices, triangles.reshape(-1), np.full(len(triangles), 3)).check()
    except (OSError, ValueError) as error:
        raise FiptError(
            "mesh-unreadable", f"{path} can't be read ({error}).", "Export the mesh again."
        ) from None
    return vertices, triangles


def _read_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    mesh = load_scene(read_limited(path, MOST_BYTES), "stl").to_mesh()
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
