# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a scanned room: triangles that share an edge, and their centers and normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..run.threads import cached_property
from .adjacency import Mesh, face_vectors, make_mesh
from .clean import noise_level

# Detail that is finer than an edge of a scan is lost, but smooth surfaces lie where they were measured: the
# standard deviation of the position of surfaces and borders is at most this multiple of the noise.
PLACE_NOISE = 24.0


@dataclass(frozen=True)
class Adjacency:
    """Pairs of triangles that share an edge.

    Attributes:
        pairs: (E, 2) int64 triangles.
        length: (E,) float64 metres of the edge.
        count: number of triangles T.
    """

    pairs: np.ndarray
    length: np.ndarray
    count: int

    def matrix(self, weight: np.ndarray) -> csr_array:
        """(T, T) symmetric matrix with the weight (E,) of each pair."""
        rows, columns = self.pairs.T
        both = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        return csr_array((np.concatenate([weight, weight]), both), shape=(self.count, self.count))


def find_adjacency(mesh: Mesh) -> Adjacency:
    """The pairs of triangles at each edge; an edge where more than two meet connects none of them."""
    return Adjacency(mesh.dual_edges, mesh.dual_lengths, len(mesh.triangles))


def averaged_normals(adjacency: Adjacency, cross: np.ndarray, rings: int) -> np.ndarray:
    """(T, 3) unit normals, averaged by area over this many rings of neighbours.

    Args:
        cross: (T, 3) normals with the areas as lengths.
    """
    step = adjacency.matrix(np.ones(len(adjacency.pairs)))
    total = cross.astype(np.float64)
    for _ in range(rings):
        total = total + step @ total
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


@dataclass(frozen=True)
class Scan:
    """The surface of a scanned mesh.

    Attributes:
        adjacency: of its triangles.
        centers: (T, 3) float64 metres.
        cross: (T, 3) float64 normals with the areas as lengths.
        noise: standard deviation of its distance from its smooth fit, before it was cleaned, metres.
    """

    adjacency: Adjacency
    centers: np.ndarray
    cross: np.ndarray
    noise: float

    @cached_property
    def edge(self) -> float:
        """Metres, median of the edges that two triangles share; detail finer than this is lost."""
        return float(np.median(self.adjacency.length))

    @property
    def place(self) -> float:
        """Standard deviation of the position of surfaces and of their borders, metres."""
        return min(self.edge, PLACE_NOISE * self.noise)


def find_scan(
    vertices: np.ndarray, triangles: np.ndarray, noise: float = 0.0, exact: np.ndarray | None = None
) -> Scan | None:
    """The surface of a mesh that is a scan, None for a modelled mesh.

    Args:
        vertices: (V, 3) metres. triangles: (T, 3) int.
        noise: of the mesh before it was cleaned, metres; 0 where it was not.
        exact: (T,) bool, triangles that do not count for whether it is a scan; None: all do.
    """
    mesh, _ = make_mesh(vertices, triangles)
    normals, areas = face_vectors(mesh.vertices, mesh.triangles)
    noise = noise or _noise(mesh, normals, areas, exact)
    if noise <= 0.0:
        return None
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    return Scan(find_adjacency(mesh), centers, normals * areas[:, None], noise)


def _noise(mesh: Mesh, normals: np.ndarray, areas: np.ndarray, exact: np.ndarray | None) -> float:
    if exact is not None:
        mesh, normals, areas = Mesh(mesh.vertices, mesh.triangles[~exact]), normals[~exact], areas[~exact]
    return noise_level(mesh, normals, areas)[0]
