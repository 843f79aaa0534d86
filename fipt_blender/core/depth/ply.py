# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused meshes as binary PLY files, with smooth normals and vertex colors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..run.runfolder import atomic_path
from .extraction import FusedMesh


def write_ply(path: Path, mesh: FusedMesh) -> None:
    """Write a mesh, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    columns = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    names = [f"property float {name}" for name, _ in columns]
    if mesh.colors is not None:
        columns += [(name, "u1") for name in ("red", "green", "blue")]
        names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    vertices = np.zeros(len(mesh.vertices), columns)
    normals = vertex_normals(mesh)
    for axis, name in enumerate("xyz"):
        vertices[name], vertices["n" + name] = mesh.vertices[:, axis], normals[:, axis]
    if mesh.colors is not None:
        codes = np.round(np.clip(mesh.colors, 0.0, 1.0) * 255.0)
        for channel, name in enumerate(("red", "green", "blue")):
            vertices[name] = codes[:, channel]
    faces = np.zeros(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def vertex_normals(mesh: FusedMesh) -> np.ndarray:
    """(V, 3) float64 unit normals: area-weighted means of the triangles around each vertex."""
    corners = mesh.vertices.astype(np.float64)[mesh.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(mesh.vertices)
    total = np.stack(
        [
            sum(np.bincount(mesh.triangles[:, corner], cross[:, axis], count) for corner in range(3))
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-30, total / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
