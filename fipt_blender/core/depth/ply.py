"""Fused meshes as binary PLY files, with smooth normals and vertex colors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..run.runfolder import atomic_path
from .extraction import FusedMesh


def write_ply(path: Path, mesh: FusedMesh) -> None:
    """Write a mesh, completely or not at all."""
    import trimesh  # here: each import of a capture loads this module, and trimesh takes half of that time
    from trimesh.exchange.ply import export_ply

    codes = None if mesh.colors is None else np.round(np.clip(mesh.colors, 0.0, 1.0) * 255.0).astype(np.uint8)
    # Normals are area-weighted means of the triangles around each vertex.
    crosses = trimesh.triangles.cross(mesh.vertices.astype(np.float64)[mesh.triangles])
    normals = trimesh.geometry.mean_vertex_normals(len(mesh.vertices), mesh.triangles, crosses)
    found = trimesh.Trimesh(
        mesh.vertices, mesh.triangles, vertex_normals=normals, vertex_colors=codes, process=False
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(export_ply(found, vertex_normal=True))
