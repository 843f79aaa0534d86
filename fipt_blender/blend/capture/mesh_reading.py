# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Blender of its own does for `core.capture.mesh_file`: reads a mesh file and writes its arrays."""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ..room.mesh_arrays import corner_vertices, triangle_loops, vertex_positions
from .mesh_import import import_meshes


def read(path: Path, arrays: Path) -> None:
    """Write vertices (V, 3) float64 and triangles (T, 3) int64 of a mesh file to a .npz file.

    Raises:
        FiptError: those of `import_meshes`, or ``mesh-unreadable``.
    """
    vertices, triangles, count = [], [], 0
    for name in import_meshes(path, np.eye(4)):
        mesh = bpy.data.objects[name].data
        corners = corner_vertices(mesh)
        if corners.min() < 0 or corners.max() >= len(mesh.vertices):
            text = f"The mesh {path} can't be used: its faces have vertices that are not there."
            raise FiptError("mesh-unreadable", text, "Export the mesh again.")
        vertices.append(vertex_positions(mesh).astype(np.float64))
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
