"""Patches: the triangles of a mesh in one cell of a grid that face the same way, with their best plane.

The noise of a scan is correlated over several triangles. A patch is wider than that, so that its plane has a
better normal than any of its triangles, and its flatness shows the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .adjacency import Mesh


@dataclass(frozen=True)
class Moments:
    """Area, mean and second moments of G sets of triangles, about one common origin.

    Attributes:
        area: (G,) square metres.
        first: (G, 3) integral of the position.
        second: (G, 6) integrals of xx, yy, zz, xy, xz, yz.
    """

    area: np.ndarray
    first: np.ndarray
    second: np.ndarray

    def grouped(self, group: np.ndarray, count: int) -> Moments:
        """Sums over the sets of each group (G,) int; negative groups do not count."""
        known = group >= 0
        group = group[known]

        def added(values: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(group, column, count) for column in values[known].T], axis=1)

        return Moments(np.bincount(group, self.area[known], count), added(self.first), added(self.second))

    def total(self, chosen: np.ndarray) -> Moments:
        """The sum (one set) over the sets `chosen` (K,) int."""
        return Moments(
            self.area[chosen].sum(keepdims=True),
            self.first[chosen].sum(axis=0, keepdims=True),
            self.second[chosen].sum(axis=0, keepdims=True),
        )

    def planes(self) -> Planes:
        """The plane of least squares of each set."""
        area = np.maximum(self.area, 1e-30)[:, None]
        centre = self.first / area
        xx, yy, zz, xy, xz, yz = (self.second / area).T
        moment = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        values, vectors = np.linalg.eigh(moment - centre[:, :, None] * centre[:, None, :])
        deviation, spread = np.sqrt(np.maximum(values[:, :2], 0.0)).T
        return Planes(vectors[:, :, 0], centre, deviation, np.sqrt(12.0) * spread)


@dataclass(frozen=True)
class Planes:
    """G planes.

    Attributes:
        normal: (G, 3) unit, of either sign.
        centre: (G, 3) a point on each: the mean of its set.
        deviation: (G,) root mean square distance of the set, metres.
        width: (G,) shorter side of a rectangle with the second moments of the set, metres.
    """

    normal: np.ndarray
    centre: np.ndarray
    deviation: np.ndarray
    width: np.ndarray

    def turned(self, toward: np.ndarray) -> Planes:
        """The planes with the normals on the side of the directions `toward` (G, 3)."""
        flip = np.einsum("gc,gc->g", self.normal, toward) < 0.0
        return replace(self, normal=np.where(flip[:, None], -self.normal, self.normal))

    def distance(self, plane: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(N,) signed distance of points (N, 3) from the planes of index (N,)."""
        return np.einsum("nc,nc->n", points - self.centre[plane], self.normal[plane])


def triangle_moments(mesh: Mesh, areas: np.ndarray) -> Moments:
    """Moments of each triangle about the origin; `areas` (T,)."""
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    total = a + b + c
    # The integral of x_i x_j over a triangle is A / 12 (sum over corners of x_i x_j, plus S_i S_j).
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    columns = [
        (a[:, i] * a[:, j] + b[:, i] * b[:, j] + c[:, i] * c[:, j] + total[:, i] * total[:, j]) / 12.0
        for i, j in pairs
    ]
    return Moments(areas, total / 3.0 * areas[:, None], np.stack(columns, axis=1) * areas[:, None])


def find_patches(mesh: Mesh, normals: np.ndarray, size: float) -> tuple[np.ndarray, int]:
    """(T,) int64 patch of each triangle, and the number of patches.

    Args:
        normals: (T, 3) unit normals.
        size: width of a cell, metres.
    """
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    cell = np.floor((middle - mesh.vertices.min(axis=0)) / size).astype(np.int64)
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] < 0.0)
    key = ((cell[:, 0] << 20 | cell[:, 1]) << 20 | cell[:, 2]) * 6 + side
    number = np.unique(key, return_inverse=True)[1].reshape(-1)
    return number, int(number.max(initial=-1)) + 1
