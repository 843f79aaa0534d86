"""Fused meshes without specks in the air, and meshes of millions of triangles simplified to a budget.

Edges collapse by quadric errors (Garland and Heckbert 1997) where the surface stays, so that flat walls lose
most triangles and borders stay.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

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
