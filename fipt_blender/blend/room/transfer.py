"""Which surface of the run's room each face of a mesh stands for: the same face, or the nearest one.

The artist may have deleted, joined, moved or subdivided faces since the room was exported. A face without a
counterpart keeps what it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...bridge.step import Slices
from .mesh_arrays import (
    area_normals,
    barycentric,
    corner_vertices,
    polygon_sizes,
    polygon_starts,
    transform_points,
    triangle_loops,
    vertex_positions,
)

# How far the centre of a face may be from its counterpart: a share of the diagonal of the room's bounding box
# (5 cm in a room of 10 m), so that rounded edges and thin cladding count and the next surface does not.
POSITION_SHARE = 0.005
NORMAL_DEGREES = (
    60.0  # between the normals of both; rounded edges lie up to 45 degrees from both of their faces
)
_CHUNK = 2048  # faces of a slice, a few hundredths of a second


@dataclass
class Counterparts:
    """What the faces of a mesh show of the run's room.

    Attributes:
        triangle: (P,) i32 triangle of the room that each polygon shows, -1 for none.
        corner: (L,) i32 triangle of whose corners each face corner has the values, -1 for none.
        weights: (L,3) f32 of that triangle's corners.
    """

    triangle: np.ndarray
    corner: np.ndarray
    weights: np.ndarray

    @classmethod
    def none(cls, mesh: bpy.types.Mesh) -> Counterparts:
        """Those of a mesh of which no face has one."""
        loops = len(mesh.loops)
        return cls(
            np.full(len(mesh.polygons), -1, np.int32),
            np.full(loops, -1, np.int32),
            np.zeros((loops, 3), np.float32),
        )

    def values(self, of_triangles: np.ndarray, present: np.ndarray) -> np.ndarray:
        """(L,C) values of the face corners, given those of the triangles' corners (T,3,C).

        Args:
            present: (L,C) values of corners without a counterpart.
        """
        found = self.corner >= 0
        values = present.copy()
        of_corner = of_triangles[self.corner[found]]
        values[found] = np.einsum("lk,lkc->lc", self.weights[found], of_corner)
        return values


class Surfaces:
    """The room's triangles for the search of the nearest one.

    Args:
        vertices: (V,3) in the world.
        triangles: (T,3).
        chart: (T,) int; the corners of a face get values of one chart alone.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, chart: np.ndarray) -> None:
        self.corners = vertices[triangles].astype(np.float64)
        self._vertices, self._triangles = vertices, triangles
        self.chart = chart
        self.distance = POSITION_SHARE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self._order = np.argsort(chart, kind="stable")
        self._starts = np.searchsorted(chart[self._order], np.arange(int(chart.max(initial=0)) + 2))
        self._tree: BVHTree | None = None
        self._trees: dict[int, BVHTree] = {}

    def nearest(self, center: Vector, normal: Vector) -> int:
        """The nearest triangle that faces the same way, else one that faces away; -1 where none is near.

        Joining objects of which one is mirrored turns faces inside out.
        """
        if self._tree is None:
            self._tree = _tree(self._vertices, self._triangles)
        _, other, index, _ = self._tree.find_nearest(center, self.distance)
        if index is None:
            return -1
        if normal.dot(other) >= _COSINE:
            return int(index)
        near = self._tree.find_nearest_range(center, self.distance)
        alike = ((normal.dot(other), distance, index) for _, other, index, distance in near)
        found = [
            (cosine < 0.0, distance, index) for cosine, distance, index in alike if abs(cosine) >= _COSINE
        ]
        return min(found)[2] if found else -1

    def on_chart(self, point: Vector, chart: int) -> tuple[int, Vector]:
        """The nearest triangle of a chart, and its nearest point."""
        rows = self._order[self._starts[chart] : self._starts[chart + 1]]
        if chart not in self._trees:
            used, corners = np.unique(self._triangles[rows], return_inverse=True)
            self._trees[chart] = _tree(self._vertices[used], corners.reshape(-1, 3))
        position, _, index, _ = self._trees[chart].find_nearest(point)
        return int(rows[index]), position


_COSINE = math.cos(math.radians(NORMAL_DEGREES))


def _tree(vertices: np.ndarray, triangles: np.ndarray) -> BVHTree:
    return BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True, epsilon=0.0)


def exported(mesh: bpy.types.Mesh, mirrored: bool, rows: np.ndarray, first: np.ndarray) -> Counterparts:
    """The counterparts of a mesh with the exported faces.

    Args:
        mesh: the mesh.
        mirrored: whether its object is.
        rows: (n,) the object's triangles in the room.
        first: (P,) place in `rows` of the first triangle of each polygon; its others follow.
    """
    found = Counterparts.none(mesh)
    loops, polygon = triangle_loops(mesh, mirrored)
    start = np.searchsorted(polygon, polygon)  # the triangles of a polygon follow each other
    row = rows[first[polygon] + np.arange(len(polygon)) - start]
    found.triangle[polygon[::-1]] = row[::-1]
    found.corner[loops.ravel()] = np.repeat(row, 3)
    found.weights[loops.ravel()] = np.tile(np.eye(3, dtype=np.float32), (len(row), 1))
    return found


def copy_same(
    mesh: bpy.types.Mesh, found: Counterparts, other: bpy.types.Mesh, of_other: Counterparts
) -> None:
    """Give the faces of a mesh the counterparts of those of another one that have the same corners."""
    place = same_polygons(mesh, other)
    same = np.flatnonzero(place >= 0)
    found.triangle[same] = of_other.triangle[place[same]]
    starts, sizes = polygon_starts(mesh), polygon_sizes(mesh)
    loops = _corners_of(starts[same], sizes[same])
    others = _corners_of(polygon_starts(other)[place[same]], sizes[same])
    found.corner[loops], found.weights[loops] = of_other.corner[others], of_other.weights[others]


def same_polygons(mesh: bpy.types.Mesh, other: bpy.types.Mesh) -> np.ndarray:
    """(P,) polygon of another mesh with exactly the corners of each polygon in their order; -1 for none."""
    count = len(mesh.polygons)
    if not count or not len(other.polygons):
        return np.full(count, -1)
    keys, first = np.concatenate([_keys(other), _keys(mesh)]), len(other.polygons)
    _, lowest, group = np.unique(keys, return_index=True, return_inverse=True)
    place = lowest[group.ravel()[first:]]
    place = np.where(place < first, place, -1)
    same = np.flatnonzero(place >= 0)
    sizes = polygon_sizes(mesh)[same]
    equal = _corner_positions(mesh)[_corners_of(polygon_starts(mesh)[same], sizes)]
    equal = equal == _corner_positions(other)[_corners_of(polygon_starts(other)[place[same]], sizes)]
    if len(same):
        starts = np.cumsum(sizes) - sizes
        place[same[~np.logical_and.reduceat(equal.all(axis=1), starts)]] = -1
    return place


def _keys(mesh: bpy.types.Mesh) -> np.ndarray:
    """(P,) number and first three corners of each polygon, as bytes."""
    starts = polygon_starts(mesh)
    corners = _corner_positions(mesh)[starts[:, None] + np.arange(3)].reshape(-1, 9)
    sizes = polygon_sizes(mesh).astype(np.float32)[:, None]
    rows = np.ascontiguousarray(np.concatenate([corners, sizes], axis=1)) + np.float32(0.0)  # no -0
    return rows.view(f"V{rows.dtype.itemsize * rows.shape[1]}").ravel()


def _corner_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    return vertex_positions(mesh).astype(np.float32)[corner_vertices(mesh)]


def _corners_of(starts: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The face corners of polygons, one polygon after the other."""
    offsets = np.cumsum(sizes) - sizes
    return np.repeat(starts - offsets, sizes) + np.arange(int(sizes.sum()))


def find_nearest(
    mesh: bpy.types.Mesh, found: Counterparts, matrix: np.ndarray, surfaces: Surfaces
) -> Slices[None]:
    """Give the faces that have no counterpart the nearest triangles, within the tolerances.

    Args:
        mesh: read at once: it may be gone in later slices.
        found: of the mesh; changed.
        matrix: 4x4, the mesh's space to that of the surfaces.
        surfaces: of the room.
    """
    missing = np.flatnonzero(found.triangle < 0)
    if not len(missing):
        return
    corners = transform_points(vertex_positions(mesh), matrix)[corner_vertices(mesh)]
    starts, sizes = polygon_starts(mesh), polygon_sizes(mesh)
    normals = area_normals(corners, starts) * np.sign(np.linalg.det(matrix[:3, :3]))
    chosen: list[int] = []
    points: list[Vector] = []
    for number, polygon in enumerate(missing.tolist()):
        if number % _CHUNK == 0:
            yield None
        own = corners[starts[polygon] : starts[polygon] + sizes[polygon]]
        normal = normals[polygon]
        length = float(np.linalg.norm(normal))
        triangle = surfaces.nearest(Vector(own.mean(axis=0)), Vector(normal / length)) if length else -1
        if triangle < 0:
            continue
        found.triangle[polygon] = triangle
        for loop, corner in enumerate(own, start=int(starts[polygon])):
            on, point = surfaces.on_chart(Vector(corner), int(surfaces.chart[triangle]))
            found.corner[loop] = on
            chosen.append(loop)
            points.append(point)
    if chosen:
        triangles = surfaces.corners[found.corner[chosen]]
        found.weights[chosen] = barycentric(np.array(points), triangles)
