# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbours on the mesh: triangles that share an edge, and which pieces of the mesh a scanner has made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

# A mesh is a scan if the normals of three quarters of its area deviate from those around them by this angle
# (radians). Modelled rooms have flat walls, whose deviation is zero; no wall of a scan is flat.
ROUGH = 0.005
FLAT_SHARE = 0.25
# A scan has at least so many triangles.
LEAST_TRIANGLES = 5000
# Rings of triangles over which normals are averaged to measure the deviation.
RINGS = 2


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


def find_adjacency(vertices: np.ndarray, corners: np.ndarray) -> Adjacency:
    """The pairs of triangles at each edge; where more than two meet, each with the next.

    Args:
        vertices: (V, 3) metres, by welded index.
        corners: (T, 3) int welded vertex indices.
    """
    count = len(corners)
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end)
    key = low * (int(corners.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
    edge = order[same]
    length = np.linalg.norm(vertices[start[edge]] - vertices[end[edge]].astype(np.float64), axis=1)
    apart = pairs[:, 0] != pairs[:, 1]
    return Adjacency(pairs[apart], length[apart], count)


def averaged_normals(adjacency: Adjacency, cross: np.ndarray, rings: int) -> np.ndarray:
    """(T, 3) unit normals, averaged by area over so many rings of neighbours.

    Args:
        cross: (T, 3) normals with the areas as lengths.
    """
    step = adjacency.matrix(np.ones(len(adjacency.pairs)))
    total = cross.astype(np.float64)
    for _ in range(rings):
        total = total + step @ total
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def is_scan(adjacency: Adjacency, cross: np.ndarray) -> bool:
    """Whether the whole mesh is rough, as a scanner leaves it.

    Args:
        cross: (T, 3) normals with the areas as lengths.
    """
    if len(cross) < LEAST_TRIANGLES:
        return False
    area = np.linalg.norm(cross, axis=1)
    unit = cross / np.maximum(area[:, None], 1e-30)
    cosine = (unit * averaged_normals(adjacency, cross, RINGS)).sum(axis=1)
    flat = area @ (cosine > np.cos(ROUGH))
    return bool(flat < FLAT_SHARE * area.sum())


@dataclass(frozen=True)
class Scan:
    """The surface of a scanned mesh.

    Attributes:
        adjacency: of its triangles.
        centers: (T, 3) float64 metres.
        cross: (T, 3) float64 normals with the areas as lengths.
    """

    adjacency: Adjacency
    centers: np.ndarray
    cross: np.ndarray


def find_scan(vertices: np.ndarray, triangles: np.ndarray, cleaned: bool = False) -> Scan | None:
    """The surface of a mesh that is a scan, None for a modelled mesh.

    Args:
        vertices: (V, 3) metres. triangles: (T, 3) int.
        cleaned: the mesh is a scan that is no longer rough.
    """
    places = np.asarray(vertices, np.float64)
    corners = places[triangles]
    cross = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    welded = weld(vertices)
    of_welded = np.zeros((int(welded.max(initial=-1)) + 1, 3))
    of_welded[welded] = places
    adjacency = find_adjacency(of_welded, welded[triangles])
    if not cleaned and not is_scan(adjacency, cross):
        return None
    return Scan(adjacency, corners.mean(axis=1), cross)


def weld(vertices: np.ndarray) -> np.ndarray:
    """(V,) int64 index of each vertex after merging those at the same position (to 1e-6 of the extent)."""
    extent = float(np.ptp(vertices, axis=0).max(initial=0.0)) or 1.0
    cells = np.round(vertices.astype(np.float64) / (1e-6 * extent)).astype(np.int64)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
