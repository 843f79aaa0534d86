"""Neighbours in triangle meshes: triangles that share an edge, vertices that an edge connects, and the
triangles around each vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..run.threads import cached_property

NONE = -1  # in place of a triangle
# Vertices closer than this share of the mesh's extent are one.
_WELD = 1e-6
_BITS = 21  # of each coordinate in a packed position

# Vertices (V, 3), triangles (T, 3), corner normals (T, 3, 3), and plane (T,) or NONE of each triangle.
Surface = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh whose coincident vertices are one.

    Attributes:
        vertices: (V, 3) float64, metres.
        triangles: (T, 3) int64.
    """

    vertices: np.ndarray
    triangles: np.ndarray

    @cached_property
    def opposite(self) -> tuple[np.ndarray, np.ndarray]:
        """The other sides of edges; an edge is three times its triangle plus the corner where it starts.

        Returns:
            (3 T,) int64 the same edge of the triangle beyond, NONE at open edges and where more than two
            triangles meet, and (O,) int64 the open edges, ascending.
        """
        first, second = self.triangles, np.roll(self.triangles, -1, axis=1)
        key = (np.minimum(first, second) * len(self.vertices) + np.maximum(first, second)).reshape(-1)
        order = np.argsort(key, kind="stable")
        start = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
        uses = np.diff(start)
        pairs = start[:-1][uses == 2]
        one, other = order[pairs], order[pairs + 1]
        result = np.full(len(key), NONE, np.int64)
        result[one], result[other] = other, one
        return result, np.sort(order[start[:-1][uses == 1]])

    @cached_property
    def neighbours(self) -> np.ndarray:
        """(T, 3) int64 triangle on the other side of each edge (from corner i to corner i + 1), or NONE."""
        return self.opposite[0].reshape(-1, 3) // 3

    @cached_property
    def _shared(self) -> np.ndarray:
        """(E,) int64 edges that two triangles share, each once: three times the triangle plus the corner."""
        return np.flatnonzero(self.neighbours.reshape(-1) > np.repeat(np.arange(len(self.triangles)), 3))

    @cached_property
    def dual_edges(self) -> np.ndarray:
        """(E, 2) int64 pairs of triangles that share an edge, each pair once."""
        return np.stack([self._shared // 3, self.neighbours.reshape(-1)[self._shared]], axis=1)

    @cached_property
    def dual_lengths(self) -> np.ndarray:
        """(E,) float64 metres, of the edge that each of `dual_edges` shares."""
        start, end = self.triangles, np.roll(self.triangles, -1, axis=1)
        ends = (self.vertices[corner.reshape(-1)[self._shared]] for corner in (start, end))
        return np.linalg.norm(np.subtract(*ends), axis=1)

    def dual_matrix(self, weight: np.ndarray) -> csr_array:
        """(T, T) symmetric matrix with the weight (E,) of each of `dual_edges`."""
        rows, columns = self.dual_edges.T
        both = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        count = len(self.triangles)
        return csr_array((np.concatenate([weight, weight]), both), shape=(count, count))

    @cached_property
    def around(self) -> csr_array:
        """(V, T) sparse float32: 1 where a triangle has the vertex as a corner."""
        rows = self.triangles.reshape(-1)
        columns = np.repeat(np.arange(len(self.triangles)), 3)
        shape = len(self.vertices), len(self.triangles)
        return csr_array((np.ones(len(rows), np.float32), (rows, columns)), shape)

    @cached_property
    def ring(self) -> csr_array:
        """(V, V) sparse float64: rows of equal weights with the sum 1 on the vertices that edges connect."""
        first, second = self.triangles.reshape(-1), np.roll(self.triangles, -1, axis=1).reshape(-1)
        rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
        count = len(self.vertices)
        graph = csr_array((np.ones(len(rows)), (rows, columns)), (count, count))
        graph.sum_duplicates()
        degree = np.diff(graph.indptr)
        graph.data = np.repeat(1.0 / np.maximum(degree, 1), degree)
        return graph


def weld(vertices: np.ndarray) -> np.ndarray:
    """(V,) int64 index of each vertex after merging those at the same position (to 1e-6 of the extent).

    The indices are in the order of the positions.
    """
    extent = float(np.ptp(vertices, axis=0).max(initial=0.0)) or 1.0
    cell = np.round(vertices.astype(np.float64) / (_WELD * extent)).astype(np.int64)
    cell -= cell.min(axis=0, initial=np.iinfo(np.int64).max)
    key = (cell[:, 0] << 2 * _BITS) | (cell[:, 1] << _BITS) | cell[:, 2]
    return np.unique(key, return_inverse=True)[1].reshape(-1)


def make_mesh(vertices: np.ndarray, triangles: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """The mesh with coincident vertices welded, and (V,) int64 the welded vertex of each.

    Args:
        vertices: (V, 3) floats.
        triangles: (T, 3) int.
    """
    welded = weld(vertices)
    _, first = np.unique(welded, return_index=True)
    return Mesh(vertices[first].astype(np.float64), welded[triangles]), welded


def face_vectors(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) float64 unit normals, (0, 0, 1) for triangles without area, and (T,) areas."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    flat = length <= 1e-30
    normals = cross / np.where(flat, 1.0, length)[:, None]
    normals[flat] = (0.0, 0.0, 1.0)
    return normals, 0.5 * length


def unit(vectors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) scaled to length 1; those of no length become `otherwise` (N, 3)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), otherwise)


def without_unused(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (U,) that triangles (T, 3) use, ascending, and the triangles (T, 3) int32 in their order."""
    used, index = np.unique(triangles, return_inverse=True)
    return used, index.reshape(-1, 3).astype(np.int32)
