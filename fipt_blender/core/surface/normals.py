"""Bilateral filtering of a mesh's normals, and vertices that follow them.

The filter is that of Y. Zheng et al., "Bilateral Normal Filtering for Mesh Denoising" (2011), between
triangles that share an edge; the vertices move as in X. Sun et al., "Fast and Effective Feature-Preserving
Mesh Denoising" (2007).
"""

from __future__ import annotations

import numpy as np

from .adjacency import NONE, Mesh, face_vectors

# Rounds in which the vertices follow the normals.
VERTEX_ROUNDS = 12


def filter_normals(
    normals: np.ndarray,
    areas: np.ndarray,
    neighbours: np.ndarray,
    deviation: float,
    rounds: int,
    held: np.ndarray | None = None,
) -> np.ndarray:
    """Normals that are smooth but for creases.

    Args:
        normals: (T, 3) unit. areas: (T,).
        neighbours: (T, 3) triangle across each edge, NONE without one.
        deviation: standard deviation, in radians, of differences that are noise; larger ones are creases.
        rounds: each averages with the triangles beside.
        held: (T,) bool, triangles that keep their normal.

    Returns:
        (T, 3) float32 unit normals.
    """
    free = np.arange(len(normals)) if held is None else np.flatnonzero(~held)
    present = neighbours[free] != NONE
    index = np.where(present, neighbours[free], free[:, None]).astype(np.int32)
    weight = (areas[index] * present).astype(np.float32)
    own = areas[free].astype(np.float32)[:, None]
    # |n - m|^2 is the squared angle, for small angles.
    sharp = np.float32(-0.5 / deviation**2)
    result = normals.astype(np.float32)
    for _ in range(rounds):
        current = result[free]
        total = own * current
        for side in range(3):
            other = result[index[:, side]]
            step = other - current
            near = weight[:, side] * np.exp(sharp * np.einsum("tc,tc->t", step, step))
            total += near[:, None] * other
        result[free] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.float32(1e-20))
    return result


def follow_normals(mesh: Mesh, normals: np.ndarray, reach: float, held: np.ndarray) -> np.ndarray:
    """(V, 3) float64 vertices moved so that the triangles have the given normals, as well as they can.

    Args:
        normals: (T, 3) wanted unit normals.
        reach: metres by which a vertex may move.
        held: (V,) bool, vertices that stay.
    """
    start = mesh.vertices
    free = np.flatnonzero(~held)
    around = mesh.around[free]
    # Triangles of which no vertex moves pull none either.
    used = np.flatnonzero(np.bincount(around.indices, minlength=len(normals)))
    around, corner = around[:, used], mesh.triangles[used]
    areas = face_vectors(start, corner)[1].astype(np.float32)
    wanted = normals[used].astype(np.float32)
    total = np.maximum(around @ areas, np.float32(1e-20))[:, None]
    # Sum over the triangles j around vertex i of A_j n_j (n_j . (c_j - x_i)): the matrices before x_i stay.
    spread = [around @ ((areas * wanted[:, column])[:, None] * wanted) for column in range(3)]
    local = (start - start.mean(axis=0)).astype(np.float32)
    now = local.copy()
    for _ in range(VERTEX_ROUNDS):
        middle = (now[corner[:, 0]] + now[corner[:, 1]] + now[corner[:, 2]]) / 3.0
        height = areas * np.einsum("tc,tc->t", wanted, middle)
        lifted = around @ (height[:, None] * wanted)
        pulled = np.stack([np.einsum("vc,vc->v", row, now[free]) for row in spread], axis=1)
        moved = now[free] - local[free] + (lifted - pulled) / total
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        now[free] = local[free] + moved * np.minimum(1.0, reach / np.maximum(length, 1e-20))
    result = start.copy()
    result[free] += now[free] - local[free]
    return result


def corner_normals(mesh: Mesh, normals: np.ndarray, crease: float) -> np.ndarray:
    """(T, 3, 3) float32 unit shading normals: means around each vertex, but the triangle's own at creases.

    Args:
        normals: (T, 3) unit normals of the triangles.
        crease: cosine of the largest angle between a triangle's normal and the mean at its corner.
    """
    areas = face_vectors(mesh.vertices, mesh.triangles)[1].astype(np.float32)
    mean = mesh.around @ (normals.astype(np.float32) * areas[:, None])
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.float32(1e-20))
    result = mean[mesh.triangles]
    own = normals.astype(np.float32)[:, None]
    sharp = np.einsum("tkc,tkc->tk", result, np.broadcast_to(own, result.shape)) < crease
    return np.where(sharp[:, :, None], own, result)
