"""A mesh as points, for finding which of its triangles are nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..run.errors import FiptError
from ..run.threads import cached_property

SAMPLES = 200_000  # points of a mesh
NEIGHBOURS = 12  # samples and triangles' middles around a position whose triangles are looked at


@dataclass(frozen=True, eq=False)
class Surface:
    """Points spread evenly over a mesh."""

    points: np.ndarray  # (N, 3) float64
    triangle: np.ndarray  # (N,) the triangle that each point lies on
    corners: np.ndarray  # (T, 3, 3) float64 of all triangles

    @cached_property
    def tree(self) -> cKDTree:
        """Of the points and the middles of all triangles.

        A scan has more triangles than points: among the points' triangles alone, the nearest one to a
        position is missing, and the distance from another one points along the surface.
        """
        return cKDTree(np.concatenate([self.points, self.corners.mean(axis=1)]))

    def nearest(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) of positions (N, 3) from the nearest triangles, and directions (N, 3) from there."""
        found = self.tree.query(positions, min(NEIGHBOURS, self.tree.n))[1]
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
        return distance, directions


def sample_surface(
    vertices: np.ndarray, triangles: np.ndarray, rng: np.random.Generator, count: int = SAMPLES
) -> Surface:
    """Sample a mesh evenly by area.

    Args:
        vertices: (V, 3).
        triangles: (T, 3) vertex indices.
        rng: of the positions in the triangles.
        count: number of points.
    """
    corners = np.asarray(vertices, np.float64)[np.asarray(triangles, np.int64)]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(crosses, axis=1)
    total = float(lengths.sum()) if len(lengths) else 0.0
    if not (np.isfinite(total) and total > 0.0):
        raise FiptError("mesh-empty.sample-surface")
    # At even steps of the area, so that no part of the mesh is missed by chance.
    positions = (np.arange(count) + rng.random(count)) / count * total
    chosen = np.minimum(np.searchsorted(np.cumsum(lengths), positions), len(lengths) - 1)
    root, second = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    points = np.einsum("nk,nkc->nc", weights, corners[chosen])
    return Surface(points, chosen, corners)


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
