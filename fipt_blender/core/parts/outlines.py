"""Outlines of parts on a scan: its vertices move to where the masks of the photographs have their borders.

A scan rounds edges off and ends between two voxels, so that silhouettes and borders of parts are ragged and
lie off those of the photographs. Each view that sees an outline shows by how many pixels; the moves are the
solution of least squares over all views, small and smooth over the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import LinearOperator, cg

from ..capture.views import View
from ..pixels.camera_rays import first_hits, trace_pixels
from ..pixels.grouped import grouped_sums
from ..run.stage_settings import OutlineSettings
from ..surface.adjacency import Mesh, face_vectors, make_mesh
from ..surface.room import Room
from .labels import IMAGE_SOURCES, Parts, choose_parts, choose_source
from .outline_misses import Misses, find_misses

# Standard deviation in pixels of the place of a mask's border, which is known to half a pixel.
BORDER_DEVIATION = 0.35
# A miss of this many pixels has half the weight, as it may belong to another outline.
HALF_WEIGHT = 1.0
# Standard deviations, in edges of the mesh: of a move, of its difference between neighbours, and of a move
# off a plane of the mesh.
MOVE, DIFFERENCE, OFF_PLANE = 0.5, 0.5, 0.05
# Largest move of a vertex, in edges.
FARTHEST = 1.5
# Rings of neighbours that move with the vertices of outlines.
RINGS = 4
# Each round finds the outlines again.
ROUNDS = 3
# A triangle folds if its normal rotates beyond this cosine; the moves of its corners are then halved, at most
# this many times.
FOLD, HALVINGS = 0.3, 4
# Of the conjugate gradients: relative residual, and most steps.
_TOLERANCE, _MOST_STEPS = 1e-3, 100


def outline_parts(room: Room, views: Sequence[View], *, settings: OutlineSettings) -> np.ndarray | None:
    """(V, 3) float32 vertices of a scan on the outlines that the masks of views show; None without these.

    Mitsuba's variant must be set.
    """
    if not settings.outlines or room.plane is None or choose_source(room, views) not in IMAGE_SOURCES:
        return None
    triangles = [first_hits(trace_pixels(room, view))[0] for view in views]
    return outlined_vertices(room, views, choose_parts(room, views, triangles))


def outlined_vertices(room: Room, views: Sequence[View], parts: Parts) -> np.ndarray:
    """(V, 3) float32 vertices of a scan, moved to the outlines that its masks show.

    Args:
        room: a scan; Mitsuba's variant must be set.
        views: with masks.
        parts: from these masks.
    """
    mesh, welded = make_mesh(room.vertices, room.triangles)
    label = np.where(parts.triangle_part >= 0, np.append(parts.ids, 0)[parts.triangle_part], 0)
    edge = float(np.median(mesh.dual_lengths))
    images = ((view, view.part_ids() if parts.kind == "part" else view.semantic_ids()) for view in views)
    masks = [(view, mask) for view, mask in images if mask is not None]
    stiffness = _plane_stiffness(mesh, room.plane, OFF_PLANE * edge)
    moves = np.zeros_like(mesh.vertices)
    for _ in range(ROUNDS):
        places = mesh.vertices + moves
        now = replace(room, vertices=places.astype(np.float32), triangles=mesh.triangles.astype(np.int32))
        misses = find_misses(now, label, masks, edge)
        if not len(misses.vertex):
            break
        moves = _solved(mesh, misses, moves, stiffness, edge)
    if room.exact is not None:
        moves[mesh.triangles[room.exact]] = 0.0
    return (mesh.vertices + without_folds(mesh, moves))[welded].astype(np.float32)


def _plane_stiffness(mesh: Mesh, plane: np.ndarray | None, deviation: float) -> np.ndarray:
    """(V, 3, 3) stiffness that keeps vertices on the planes of the triangles around them.

    Args:
        plane: (T,) of each triangle, negative without one.
        deviation: metres.
    """
    stiffness = np.zeros((len(mesh.vertices), 3, 3))
    if plane is None or not (plane >= 0).any():
        return stiffness
    on = plane >= 0
    normals, areas = face_vectors(mesh.vertices, mesh.triangles)
    weighted = (normals * areas[:, None])[on]
    total = grouped_sums(weighted, plane[on])
    total = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
    vertex, number = np.divmod(np.unique(mesh.triangles[on] * len(total) + plane[on][:, None]), len(total))
    normal = total[number]
    np.add.at(stiffness, vertex, normal[:, :, None] * normal[:, None, :] / deviation**2)
    return stiffness


def _solved(mesh: Mesh, misses: Misses, moves: np.ndarray, stiffness: np.ndarray, edge: float) -> np.ndarray:
    """(V, 3) moves, in metres, that make the misses small; a step of Gauss and Newton from `moves`."""
    count = len(mesh.vertices)
    weight = 1.0 / (BORDER_DEVIATION**2 * (1.0 + (misses.pixels / HALF_WEIGHT) ** 2))
    wanted = (misses.gradient * moves[misses.vertex]).sum(axis=1) - misses.pixels
    matrix = stiffness + np.eye(3) / (MOVE * edge) ** 2
    right = np.zeros((count, 3))
    gradient = misses.gradient
    np.add.at(matrix, misses.vertex, weight[:, None, None] * gradient[:, :, None] * gradient[:, None, :])
    np.add.at(right, misses.vertex, (weight * wanted)[:, None] * gradient)
    active = np.zeros(count, bool)
    active[misses.vertex] = True
    for _ in range(RINGS):
        active |= (mesh.ring @ active.astype(np.float64)) > 0.0
    chosen = np.flatnonzero(active)
    ring = mesh.ring[chosen]
    tie = 1.0 / (DIFFERENCE * edge) ** 2
    degree = np.diff(ring.indptr)
    blocks = matrix[chosen] + (tie * degree)[:, None, None] * np.eye(3)
    number = np.full(count, -1)
    number[chosen] = np.arange(len(chosen))
    row, column = np.repeat(np.arange(len(chosen)), degree), number[ring.indices]
    row, column = row[column >= 0], column[column >= 0]  # other vertices are fixed and need no term
    ties = coo_array((np.full(len(row), tie), (row, column)), shape=(len(chosen),) * 2).tocsr()

    def product(vector: np.ndarray) -> np.ndarray:
        values = vector.reshape(-1, 3)
        return (np.einsum("nij,nj->ni", blocks, values) - ties @ values).reshape(-1)

    inverse = np.linalg.inv(blocks)
    size = (3 * len(chosen),) * 2
    system = LinearOperator(size, matvec=product, dtype=np.float64)
    guess = LinearOperator(
        size, matvec=lambda vector: np.einsum("nij,nj->ni", inverse, vector.reshape(-1, 3)).reshape(-1)
    )
    found, _ = cg(
        system,
        right[chosen].reshape(-1),
        moves[chosen].reshape(-1),
        rtol=_TOLERANCE,
        maxiter=_MOST_STEPS,
        M=guess,
    )
    result = np.zeros_like(moves)
    result[chosen] = found.reshape(-1, 3)
    length = np.linalg.norm(result, axis=1, keepdims=True)
    return np.asarray(result * np.minimum(1.0, FARTHEST * edge / np.maximum(length, 1e-20)))


def without_folds(mesh: Mesh, moves: np.ndarray) -> np.ndarray:
    """(V, 3) moves, made smaller where they would fold triangles."""
    moves = moves.copy()
    before = face_vectors(mesh.vertices, mesh.triangles)[0]
    for attempt in range(HALVINGS + 1):
        after = face_vectors(mesh.vertices + moves, mesh.triangles)[0]
        folded = np.unique(mesh.triangles[(before * after).sum(axis=1) < FOLD])
        moves[folded] *= 0.5 if attempt < HALVINGS else 0.0
    return moves
