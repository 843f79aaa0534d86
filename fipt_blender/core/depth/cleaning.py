# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused meshes without specks in the air."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .extraction import FusedMesh


def without_specks(mesh: FusedMesh, least_area: float) -> FusedMesh:
    """The mesh without connected pieces of less area, which wrong measurements leave in the air.

    Args:
        least_area: square metres.
    """
    if not len(mesh.triangles):
        return mesh
    ends = mesh.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    count = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    piece = connected_components(graph, directed=False)[1][mesh.triangles[:, 0]]
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(piece, 0.5 * np.linalg.norm(cross, axis=1))
    return _compacted(mesh, mesh.triangles[area[piece] >= least_area])


def _compacted(mesh: FusedMesh, triangles: np.ndarray) -> FusedMesh:
    """The mesh of some triangles with only the vertices that they use."""
    used, corners = np.unique(triangles, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return FusedMesh(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32), colors)
