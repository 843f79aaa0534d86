# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused meshes made tidy: specks in the air dropped, small holes closed."""

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


def with_closed_holes(mesh: FusedMesh, widest: float) -> FusedMesh:
    """The mesh with holes closed by triangles around their middles.

    Args:
        widest: metres; holes with a vertex farther than half of it from their middle stay open, like the
            outer border of what was seen.
    """
    vertices, colors, triangles = [mesh.vertices], [mesh.colors], [mesh.triangles]
    count = len(mesh.vertices)
    for loop in border_loops(mesh.triangles):
        middle = mesh.vertices[loop].mean(axis=0)
        if np.linalg.norm(mesh.vertices[loop] - middle, axis=1).max() > 0.5 * widest:
            continue
        # The border is walked in the direction of the triangles at it; those that close it walk back.
        fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), count)], axis=1)
        triangles.append(fan.astype(np.int32))
        vertices.append(middle[None].astype(np.float32))
        if mesh.colors is not None:
            colors.append(mesh.colors[loop].mean(axis=0, keepdims=True))
        count += 1
    tints = None if mesh.colors is None else np.concatenate([tint for tint in colors if tint is not None])
    return FusedMesh(np.concatenate(vertices), np.concatenate(triangles), tints)


def border_loops(triangles: np.ndarray) -> list[np.ndarray]:
    """Closed loops of vertices along edges of one triangle only, in the triangles' direction.

    Loops that touch themselves are left out.
    """
    edges = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    most = int(edges.max(initial=0)) + 1
    keys, back = edges[:, 0] * most + edges[:, 1], edges[:, 1] * most + edges[:, 0]
    open_edges = edges[~np.isin(keys, back)]
    starts, uses = np.unique(open_edges[:, 0], return_counts=True)
    forked = set(starts[uses > 1].tolist())
    following = dict(open_edges.tolist())
    loops = []
    while following:
        first, vertex = next(iter(following.items()))
        loop = [first]
        del following[first]
        while vertex in following:
            loop.append(vertex)
            vertex = following.pop(vertex)
        if vertex == first and not forked.intersection(loop):
            loops.append(np.array(loop))
    return loops


def _compacted(mesh: FusedMesh, triangles: np.ndarray) -> FusedMesh:
    """The mesh of some triangles with only the vertices that they use."""
    used, corners = np.unique(triangles, return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return FusedMesh(mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32), colors)
