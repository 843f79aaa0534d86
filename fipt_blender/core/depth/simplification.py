# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of millions of triangles simplified to a budget, by quadric errors (Garland and Heckbert 1997).

Edges collapse where the surface stays, so that flat walls lose most triangles and borders stay.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree

from .extraction import FusedMesh


def simplified(mesh: FusedMesh, triangles: int) -> FusedMesh:
    """The mesh with at most about `triangles` triangles; itself where it has no more.

    Normals follow from the new triangles; colors are means of the nearest old vertices.
    """
    if len(mesh.triangles) <= triangles:
        return mesh
    kept, faces = collapsed(mesh.vertices, mesh.triangles, triangles)
    colors = None
    if mesh.colors is not None:
        # The mean color of three old vertices.
        near = cKDTree(mesh.vertices).query(kept, min(3, len(mesh.vertices)))[1]
        colors = mesh.colors[near.reshape(len(kept), -1)].mean(axis=1).astype(np.float32)
    return FusedMesh(kept.astype(np.float32), faces, colors)


def collapsed(vertices: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (W, 3) float64 and triangles (U, 3) int32 of a mesh with at most about `count` triangles.

    Args:
        vertices: (V, 3) metres, float32 or float64.
        triangles: (T, 3), more than `count`.
    """
    middle = vertices.mean(axis=0, dtype=np.float64)  # single precision far from the origin is coarse
    near, faces = fast_simplification.simplify(
        (vertices - middle).astype(np.float32), triangles.astype(np.int32), target_count=count
    )
    kept = np.asarray(near, np.float64) + middle
    corners = kept[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return kept, faces[area > 0.0].astype(np.int32)
