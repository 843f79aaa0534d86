# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh as points with normals, for finding what is nearest; its main directions and its unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..conventions import transform_points
from ..run.errors import FiptError
from ..run.threads import cached_property

SAMPLES = 200_000  # points of a mesh
NEIGHBOURS = 12  # samples and triangles' middles around a position whose triangles are looked at
# Height of an ordinary room from floor to ceiling in metres; no two units fit the same number.
LEAST_HEIGHT, MOST_HEIGHT = 1.9, 4.6
UNITS = {"meters": 1.0, "feet": 0.3048, "inches": 0.0254, "centimeters": 0.01, "millimeters": 0.001}


@dataclass(frozen=True, eq=False)
class Surface:
    """Points spread evenly over a mesh.

    Attributes:
        points: (N, 3) float64.
        normals: (N, 3) float64 unit vectors, of either side.
        triangle: (N,) the triangle that each point lies on.
        corners: (T, 3, 3) float64 of all triangles.
    """

    points: np.ndarray
    normals: np.ndarray
    triangle: np.ndarray
    corners: np.ndarray

    @cached_property
    def tree(self) -> cKDTree:
        """Of the points; shaped for positions far from the surface, as an alignment starts with many."""
        return cKDTree(self.points, leafsize=32, compact_nodes=False)

    @cached_property
    def triangle_tree(self) -> cKDTree:
        """Of the points and the middles of all triangles.

        A scan has more triangles than points: among the points' triangles alone, the nearest one to a
        position is missing, and the distance from another one points along the surface.
        """
        return cKDTree(np.concatenate([self.points, self.corners.mean(axis=1)]))

    def moved(self, similarity: np.ndarray) -> Surface:
        """The surface in other coordinates; the similarity (4, 4) does not turn it."""
        corners = transform_points(similarity, self.corners)
        return Surface(transform_points(similarity, self.points), self.normals, self.triangle, corners)

    def part(self, chosen: np.ndarray) -> Surface:
        """Some of the points."""
        return Surface(self.points[chosen], self.normals[chosen], self.triangle[chosen], self.corners)

    def nearest_point(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The nearest points of the surface's points, each with the plane through it.

        Returns:
            Distances (N,), distances along the normals (N,) and normals (N, 3).
        """
        distances, index = self.tree.query(positions)
        normals = self.normals[index]
        return np.asarray(distances), ((positions - self.points[index]) * normals).sum(axis=1), normals

    def nearest_triangle(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same for the nearest triangles: at edges, the normal points to the position."""
        found = self.triangle_tree.query(positions, min(NEIGHBOURS, self.triangle_tree.n))[1]
        owners = np.concatenate([self.triangle, np.arange(len(self.corners))])
        index = owners[found.reshape(len(positions), -1)]
        nearest = closest_points(positions[:, None], self.corners[index])
        offsets = positions[:, None] - nearest
        distances = np.linalg.norm(offsets, axis=2)
        best = distances.argmin(axis=1)
        rows = np.arange(len(positions))
        distance = distances[rows, best]
        directions = offsets[rows, best] / np.maximum(distance, 1e-300)[:, None]
        touching = distance < 1e-9  # rounding alone gives the direction there
        directions[touching] = unit_normals(self.corners[index[rows, best][touching]])
        return distance, distance, directions


def sample_surface(
    vertices: np.ndarray, triangles: np.ndarray, rng: np.random.Generator, count: int = SAMPLES
) -> Surface:
    """Sample a mesh evenly by area.

    Args:
        vertices: (V, 3).
        triangles: (T, 3) vertex indices.
        rng: of the positions in the triangles.
        count: number of points.

    Raises:
        FiptError: ``mesh-empty`` for a mesh without area.
    """
    corners = np.asarray(vertices, np.float64)[np.asarray(triangles, np.int64)]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(crosses, axis=1)
    total = float(lengths.sum()) if len(lengths) else 0.0
    if not (np.isfinite(total) and total > 0.0):
        raise FiptError("mesh-empty", "The mesh has no surface.", "Choose a mesh with faces.")
    # At even steps of the area, so that no part of the mesh is missed by chance.
    positions = (np.arange(count) + rng.random(count)) / count * total
    chosen = np.minimum(np.searchsorted(np.cumsum(lengths), positions), len(lengths) - 1)
    root, second = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    points = np.einsum("nk,nkc->nc", weights, corners[chosen])
    return Surface(points, unit_normals(corners[chosen]), chosen, corners)


def unit_normals(corners: np.ndarray) -> np.ndarray:
    """Normals (N, 3) of triangles (N, 3, 3), zero for triangles without area."""
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(crosses / np.maximum(np.linalg.norm(crosses, axis=1), 1e-300)[:, None])


def closest_points(positions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The points of triangles that are closest to positions.

    Args:
        positions: (..., 3).
        corners: (..., 3, 3) of the triangles; leading axes are broadcast.

    Returns:
        (..., 3) float64.
    """
    first, sides = corners[..., 0, :], corners[..., [1, 2, 0], :] - corners
    normal = np.cross(sides[..., 0, :], sides[..., 1, :])
    square = np.maximum((normal**2).sum(axis=-1), 1e-300)
    offset = ((positions - first) * normal).sum(axis=-1) / square
    best = positions - offset[..., None] * normal
    turned = np.cross(normal[..., None, :], sides)  # from each edge to the inside
    inside = ((best[..., None, :] - corners) * turned).sum(axis=-1).min(axis=-1) >= 0.0
    # Outside of the triangle, the closest point lies on one of its edges.
    lengths = np.maximum((sides**2).sum(axis=-1), 1e-300)
    share = np.clip(((positions[..., None, :] - corners) * sides).sum(axis=-1) / lengths, 0.0, 1.0)
    on_edges = corners + share[..., None] * sides
    distances = ((positions[..., None, :] - on_edges) ** 2).sum(axis=-1)
    edge = np.take_along_axis(on_edges, distances.argmin(axis=-1)[..., None, None], axis=-2)[..., 0, :]
    return np.where(inside[..., None], best, edge)


def main_axes(normals: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose rows are the directions that most of a mesh faces, at right angles.

    Args:
        normals: (N, 3) unit normals of points spread evenly over the mesh.
    """
    some = normals[:: max(len(normals) // 2000, 1)]
    first = _main_direction(some, some)
    beside = some - (some @ first)[:, None] * first
    lengths = np.linalg.norm(beside, axis=1)
    beside = beside[lengths > 0.9] / lengths[lengths > 0.9, None]
    second = _main_direction(beside, beside) if len(beside) else _any_beside(first)
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)])


def _main_direction(directions: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """The direction, of either sign, near which most directions lie; averaged over them."""
    near = np.abs(candidates[:: max(len(candidates) // 300, 1)] @ directions.T) > 0.995
    best = near[int(np.argmax(near.sum(axis=1)))]
    return np.asarray(np.linalg.svd(directions[best], full_matrices=False)[2][0])


def _any_beside(direction: np.ndarray) -> np.ndarray:
    axis = np.eye(3)[int(np.argmin(np.abs(direction)))]
    return axis - (axis @ direction) * direction


def unit_of_height(height: float) -> tuple[str, float] | None:
    """Name and length in metres of the unit in which a room of this height is an ordinary one, or None."""
    for name, meters in UNITS.items():
        if LEAST_HEIGHT <= height * meters <= MOST_HEIGHT:
            return name, meters
    return None
