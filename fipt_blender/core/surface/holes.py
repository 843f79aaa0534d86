"""Flat holes of a scan, and panes that close them.

A scanner sees nothing of window panes, mirrors and other smooth dark surfaces: it leaves holes whose rims lie
in a plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .adjacency import NONE, Mesh

# A rim is flat if it lies within so many edges of its plane (root mean square).
FLATNESS = 1.0
# Least area of a hole, in squared edges: those of smaller ones are details that were lost.
MIN_AREA = 100.0
# Fewer edges are no rim.
MIN_RIM = 12
# A pane lies so many edges behind its rim, and extends under it by so many cells, so that no ray passes
# between both.
SET_BACK, OVERLAP = 0.5, 2
# Most cells of a pane along an axis.
MAX_CELLS = 500


@dataclass(frozen=True)
class FlatHole:
    """A hole whose rim lies in a plane.

    Attributes:
        centre: (3,) of the rim, metres.
        axes: (3, 3) two unit vectors in the plane and its normal, on the side of the surface around it.
        low: (2,) place of the first cell along the first two axes, from the centre.
        cell: edge of a cell, metres.
        inside: (rows, columns) bool, cells of the hole; columns run along the first axis.
    """

    centre: np.ndarray
    axes: np.ndarray
    low: np.ndarray
    cell: float
    inside: np.ndarray

    @property
    def area(self) -> float:
        """Square metres."""
        return float(self.inside.sum()) * self.cell**2

    def crossed(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which rays (N, 3) from a point enter the hole from its front, (N,) bool, and at what distance."""
        height = float((origin - self.centre) @ self.axes[2])
        toward = -directions @ self.axes[2]
        distance = np.where(toward > 1e-6, height / np.maximum(toward, 1e-6), np.inf)
        enters = np.isfinite(distance) & (height > 0.0)
        reached = np.where(enters, distance, 0.0)[:, None] * directions + (origin - self.centre)
        column, row = np.floor((reached @ self.axes[:2].T - self.low) / self.cell).astype(np.int64).T
        rows, columns = self.inside.shape
        enters &= (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        enters[enters] = self.inside[row[enters], column[enters]]
        return enters, distance

    def pane(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) float32 and triangles (T, 3) int32 of a pane behind the rim."""
        filled = binary_dilation(np.pad(self.inside, OVERLAP), iterations=OVERLAP)
        row, column = np.nonzero(filled)
        corner = np.stack([column, row], axis=1)[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
        used, index = np.unique(corner.reshape(-1, 2), axis=0, return_inverse=True)
        place = (used - OVERLAP) * self.cell + self.low
        vertices = self.centre + place @ self.axes[:2] - SET_BACK * self.cell * self.axes[2]
        quads = index.reshape(-1, 4)
        return vertices.astype(np.float32), quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)


def flat_holes(mesh: Mesh, edge: float) -> list[FlatHole]:
    """The flat holes of a mesh.

    Args:
        edge: median edge of the mesh, metres.
    """
    triangle, corner = np.nonzero(mesh.neighbours == NONE)
    ends = np.stack([mesh.triangles[triangle, corner], mesh.triangles[triangle, (corner + 1) % 3]], axis=1)
    count = len(mesh.vertices)
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), (count, count))
    rim = connected_components(graph, directed=False)[1][ends[:, 0]]
    order = np.argsort(rim, kind="stable")
    bounds = np.flatnonzero(np.diff(rim[order], prepend=-1))
    holes = [rim_hole(mesh.vertices, ends[rows], edge) for rows in np.split(order, bounds[1:]) if len(rows)]
    return [hole for hole in holes if hole is not None]


def median_edge(mesh: Mesh) -> float:
    """Metres."""
    corners = mesh.vertices[mesh.triangles]
    return float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))


def rim_hole(vertices: np.ndarray, ends: np.ndarray, edge: float) -> FlatHole | None:
    """The hole of a rim, None if it is not flat, too small or no hole.

    Args:
        ends: (E, 2) vertices of its edges, in the direction of the triangles at them.
    """
    if len(ends) < MIN_RIM:
        return None
    corners = vertices[ends]
    centre = corners[:, 0].mean(axis=0)
    axes = np.linalg.svd(corners[:, 0] - centre, full_matrices=False)[2]
    axes[2] = np.cross(axes[0], axes[1])
    local = (corners - centre) @ axes.T
    if np.sqrt((local[:, 0, 2] ** 2).mean()) > FLATNESS * edge:
        return None
    # The border of a surface runs counter-clockwise around the surface, and clockwise around a hole in it.
    enclosed = 0.5 * float(_cross(local[:, 0, :2], local[:, 1, :2]).sum())
    if abs(enclosed) < MIN_AREA * edge**2:
        return None
    if enclosed > 0.0:
        axes = axes * [[1.0], [-1.0], [-1.0]]
        local = local * [1.0, -1.0, -1.0]
    low, high = local[..., :2].min(axis=(0, 1)), local[..., :2].max(axis=(0, 1))
    columns, rows = np.ceil((high - low) / edge).astype(int) + 1
    if max(rows, columns) > MAX_CELLS:
        return None
    inside = _inside(local[..., :2] - low, edge, (rows, columns))
    return FlatHole(centre, axes, low, edge, inside)


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def _inside(edges: np.ndarray, cell: float, shape: Sequence[int]) -> np.ndarray:
    """(rows, columns) bool, cells whose centres edges (E, 2, 2) of polygons enclose (even-odd rule)."""
    rows, columns = shape
    crossings = np.zeros((rows, columns), np.int64)
    for row in range(rows):
        height = (row + 0.5) * cell
        below = edges[:, :, 1] <= height
        crossing = edges[below[:, 0] != below[:, 1]]
        (x0, y0), (x1, y1) = crossing[:, 0].T, crossing[:, 1].T
        x = x0 + (height - y0) / (y1 - y0) * (x1 - x0)
        # A crossing turns all cells whose centres lie to its right.
        first = np.ceil(x / cell - 0.5).astype(np.int64)
        np.add.at(crossings[row], first[first < columns], 1)
    return np.asarray(np.cumsum(crossings, axis=1) % 2 == 1)
