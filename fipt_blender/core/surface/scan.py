"""The surface of a scanned room: its triangles, their centers and normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.threads import cached_property
from .adjacency import Mesh, face_vectors, make_mesh
from .clean import noise_level

# Detail that is finer than an edge of a scan is lost, but smooth surfaces lie where they were measured: the
# standard deviation of the position of surfaces and borders is at most this multiple of the noise.
PLACE_NOISE = 24.0


def averaged_normals(mesh: Mesh, cross: np.ndarray, rings: int) -> np.ndarray:
    """(T, 3) unit normals, averaged by area over this many rings of neighbours.

    Args:
        cross: (T, 3) normals with the areas as lengths.
    """
    step = mesh.dual_matrix(np.ones(len(mesh.dual_edges)))
    total = cross.astype(np.float64)
    for _ in range(rings):
        total = total + step @ total
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


@dataclass(frozen=True)
class Scan:
    """The surface of a scanned mesh.

    Attributes:
        mesh: its triangles.
        centers: (T, 3) float64 metres.
        cross: (T, 3) float64 normals with the areas as lengths.
        noise: standard deviation of its distance from its smooth fit, before it was cleaned, metres.
    """

    mesh: Mesh
    centers: np.ndarray
    cross: np.ndarray
    noise: float

    @cached_property
    def edge(self) -> float:
        """Metres, median of the edges that two triangles share; detail finer than this is lost."""
        return float(np.median(self.mesh.dual_lengths))

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
    rows = slice(None) if exact is None else ~exact
    judged = Mesh(mesh.vertices, mesh.triangles[rows]), normals[rows], areas[rows]
    noise = noise or noise_level(*judged)[0]
    if noise <= 0.0:
        return None
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    return Scan(mesh, centers, normals * areas[:, None], noise)
