"""Materials at the surfaces of traced paths, as Dr.Jit gathers.

A network can't be evaluated inside a traced loop, so the fields are first sampled on a lattice over each
triangle and interpolated there (mesh colours: C. Yuksel et al., ACM TOG 29(2), 2010). Unlike a voxel cache,
this separates the two sides of a thin wall and touching objects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from fipt_blender.core.optics.brdf import MIN_ROUGHNESS, Material
from fipt_blender.core.surface.room import Room

# positions (N, 3) float32 in world metres, triangles (N,) int32 ->
# base colour (N, 3), roughness (N,), metallic (N,)
FieldQuery = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


class SurfaceMaterials(Protocol):
    """Materials of a path tracer."""

    def lookup(self, position: mi.Point3f, triangle: mi.UInt32, active: mi.Bool = True) -> Material:
        """The material at points on triangles."""
        ...


class TriangleMaterials:
    """One material per triangle.

    Args:
        base_color: (T, 3). roughness: (T,). metallic: (T,).
    """

    def __init__(self, base_color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray) -> None:
        self._color, self._roughness, self._metallic = _tables(base_color, roughness, metallic)

    def lookup(self, position: mi.Point3f, triangle: mi.UInt32, active: mi.Bool = True) -> Material:
        """The material of each triangle; see `SurfaceMaterials`."""
        return Material(
            dr.gather(mi.Color3f, self._color, triangle, active),
            dr.gather(mi.Float, self._roughness, triangle, active),
            dr.gather(mi.Float, self._metallic, triangle, active),
        )


@dataclass(frozen=True)
class Lattice:
    """A lattice of sample points over each triangle of a room.

    Triangle t has (columns[t] + 1) * (rows[t] + 1) points from first[t] on, row by row; point (i, j) has
    barycentric coordinates i / columns and j / rows along the edges that leave corner[t] (towards the next
    and the one after it). Points beyond the third edge are moved onto it.

    Attributes:
        first, columns, rows: (T,) int64.
        corner: (T,) int64 in 0..2; a corner of the triangle's shortest edge, so that slivers need few points.
    """

    first: np.ndarray
    columns: np.ndarray
    rows: np.ndarray
    corner: np.ndarray

    @property
    def count(self) -> int:
        """Number of points of all triangles."""
        return int(((self.columns + 1) * (self.rows + 1)).sum())

    def points(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangle (N,) and barycentric coordinates (N,), (N,) of the points of triangles start..stop."""
        width = self.columns[start:stop] + 1
        sizes = width * (self.rows[start:stop] + 1)
        local = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        triangle = np.repeat(np.arange(start, stop), sizes)
        width = np.repeat(width, sizes)
        along = (local % width) / self.columns[triangle]
        across = (local // width) / self.rows[triangle]
        beyond = np.maximum(along + across, 1.0)
        return triangle, along / beyond, across / beyond


def make_lattice(room: Room, spacing: float, most_points: int = 3_000_000) -> Lattice:
    """A lattice of points at most `spacing` metres apart; the spacing grows until there are `most_points`.

    Each triangle keeps its corners, so a mesh of very many triangles may exceed `most_points`.
    """
    corners = room.vertices.astype(np.float64)[room.triangles]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)  # edge k leaves corner k
    corner = edges.argmin(axis=1)
    pick = np.arange(len(corners))
    along, across = edges[pick, corner], edges[pick, (corner + 2) % 3]
    while True:
        columns = np.maximum(np.ceil(along / spacing), 1).astype(np.int64)
        rows = np.maximum(np.ceil(across / spacing), 1).astype(np.int64)
        sizes = (columns + 1) * (rows + 1)
        if sizes.sum() <= max(most_points, 4 * len(corners)):
            return Lattice(np.cumsum(sizes) - sizes, columns, rows, corner)
        spacing *= 1.25


class LatticeMaterials:
    """Fields sampled on a lattice over the room's triangles.

    Args:
        room: the room.
        query: the fields; called with about half a million points at a time.
        spacing: distance of the samples in metres; see `make_lattice`.
        most_points: see `make_lattice`.
    """

    def __init__(
        self, room: Room, query: FieldQuery, spacing: float = 0.01, most_points: int = 3_000_000
    ) -> None:
        lattice = make_lattice(room, spacing, most_points)
        base_color, roughness, metallic = sample_lattice(room, lattice, query)
        self._color, self._roughness, self._metallic = _tables(base_color, roughness, metallic)
        origin, edge_1, edge_2 = _oriented(room, lattice)
        # Barycentric coordinates are linear in position: b = gradient . (p - origin).
        normal = np.cross(edge_1, edge_2)
        square = np.maximum((normal**2).sum(axis=1, keepdims=True), 1e-40)
        self._origin = _flat(origin)
        self._gradient_1 = _flat(np.cross(edge_2, normal) / square)
        self._gradient_2 = _flat(np.cross(normal, edge_1) / square)
        self._first = mi.UInt32(lattice.first.astype(np.uint32))
        self._columns = mi.UInt32(lattice.columns.astype(np.uint32))
        self._rows = mi.UInt32(lattice.rows.astype(np.uint32))

    def lookup(self, position: mi.Point3f, triangle: mi.UInt32, active: mi.Bool = True) -> Material:
        """Linear interpolation between the three lattice points around each position."""
        active = mi.Bool(active)
        offset = position - dr.gather(mi.Point3f, self._origin, triangle, active)
        columns = dr.gather(mi.UInt32, self._columns, triangle, active)
        rows = dr.gather(mi.UInt32, self._rows, triangle, active)
        along = dr.dot(dr.gather(mi.Vector3f, self._gradient_1, triangle, active), offset)
        across = dr.dot(dr.gather(mi.Vector3f, self._gradient_2, triangle, active), offset)
        x = dr.clip(along, 0.0, 1.0) * mi.Float(columns)
        y = dr.clip(across, 0.0, 1.0) * mi.Float(rows)
        column = dr.minimum(mi.UInt32(x), dr.maximum(columns, 1) - 1)
        row = dr.minimum(mi.UInt32(y), dr.maximum(rows, 1) - 1)
        x -= mi.Float(column)
        y -= mi.Float(row)
        # Each cell has two triangles; in the upper one the weights start from the opposite corner.
        upper = x + y > 1.0
        stride = columns + 1
        lower_corner = dr.gather(mi.UInt32, self._first, triangle, active) + row * stride + column
        corner = dr.select(upper, lower_corner + stride + 1, lower_corner)
        beside = dr.select(upper, lower_corner + stride, lower_corner + 1)
        above = dr.select(upper, lower_corner + 1, lower_corner + stride)
        weight_beside = dr.select(upper, 1.0 - x, x)
        weight_above = dr.select(upper, 1.0 - y, y)
        weight_corner = 1.0 - weight_beside - weight_above

        def blend(kind: type, table: mi.Float) -> mi.Color3f | mi.Float:
            return (
                dr.gather(kind, table, corner, active) * weight_corner
                + dr.gather(kind, table, beside, active) * weight_beside
                + dr.gather(kind, table, above, active) * weight_above
            )

        return Material(
            blend(mi.Color3f, self._color),
            blend(mi.Float, self._roughness),
            blend(mi.Float, self._metallic),
        )


def sample_lattice(
    room: Room, lattice: Lattice, query: FieldQuery, chunk: int = 1 << 19
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fields at the lattice's points: base colour (N, 3), roughness (N,), metallic (N,), float32."""
    base_color = np.zeros((lattice.count, 3), np.float32)
    roughness = np.ones(lattice.count, np.float32)
    metallic = np.zeros(lattice.count, np.float32)
    origin, edge_1, edge_2 = _oriented(room, lattice)
    ends = lattice.first + (lattice.columns + 1) * (lattice.rows + 1)
    start = 0
    while start < len(ends):
        stop = int(np.searchsorted(ends, lattice.first[start] + chunk, side="right"))
        stop = max(stop, start + 1)
        triangle, along, across = lattice.points(start, stop)
        position = origin[triangle] + along[:, None] * edge_1[triangle] + across[:, None] * edge_2[triangle]
        part = slice(int(lattice.first[start]), int(ends[stop - 1]))
        base_color[part], roughness[part], metallic[part] = query(
            position.astype(np.float32), triangle.astype(np.int32)
        )
        start = stop
    return base_color, roughness, metallic


def _oriented(room: Room, lattice: Lattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lattice corner and the two edges leaving it, each (T, 3) float64."""
    corners = room.vertices.astype(np.float64)[room.triangles]
    pick = np.arange(len(corners))
    origin = corners[pick, lattice.corner]
    return (
        origin,
        corners[pick, (lattice.corner + 1) % 3] - origin,
        corners[pick, (lattice.corner + 2) % 3] - origin,
    )


def _tables(
    base_color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray
) -> tuple[mi.Float, mi.Float, mi.Float]:
    return (
        _flat(np.clip(base_color, 0.0, 1.0)),
        _flat(np.clip(roughness, MIN_ROUGHNESS, 1.0)),
        _flat(np.clip(metallic, 0.0, 1.0)),
    )


def _flat(array: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(array, np.float32).reshape(-1))
