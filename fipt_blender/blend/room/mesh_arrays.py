"""Blender meshes as numpy arrays."""

from __future__ import annotations

from collections.abc import Iterable

import bmesh
import bpy
import numpy as np
from mathutils import Vector


def is_mirrored(item: bpy.types.Object) -> bool:
    """Whether the object's transform turns its triangles inside out (negative determinant)."""
    return item.matrix_world.to_3x3().determinant() < 0.0


def triangle_loops(mesh: bpy.types.Mesh, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
    """A mesh's triangulation in the order of room.npz.

    Args:
        mesh: any mesh.
        mirrored: swap two corners, so that the winding still faces outwards in world space.

    Returns:
        loops (T,3) i32 indices of face corners, polygons (T,) i32.
    """
    mesh.calc_loop_triangles()
    loops = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.loop_triangles.foreach_get("loops", loops)
    polygons = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangle_polygons.foreach_get("value", polygons)
    loops = loops.reshape(-1, 3)
    return (loops[:, [0, 2, 1]] if mirrored else loops), polygons


def vertex_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """(V,3) f64, in the mesh's own space."""
    positions = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", positions)
    return positions.reshape(-1, 3).astype(np.float64)


def corner_vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    """Vertex index of each face corner, (L,) i32."""
    vertices = np.empty(len(mesh.loops), np.int32)
    if mesh.is_editmode:  # Blender shows no attributes there
        mesh.loops.foreach_get("vertex_index", vertices)
    elif len(vertices):  # ten times as fast
        mesh.attributes[".corner_vert"].data.foreach_get("value", vertices)
    return vertices


def corner_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    """Shading normal of each face corner, (L,3) f32, in the mesh's own space."""
    normals = np.empty(len(mesh.loops) * 3, np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    return normals.reshape(-1, 3)


def corner_uvs(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """UV position of each face corner in a layer, (L,2) f64."""
    uvs = np.empty(len(mesh.loops) * 2, np.float32)
    layer.uv.foreach_get("vector", uvs)
    return uvs.reshape(-1, 2).astype(np.float64)


def polygon_starts(mesh: bpy.types.Mesh) -> np.ndarray:
    """Index of each polygon's first face corner, (P,) i32."""
    starts = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    return starts


def polygon_sizes(mesh: bpy.types.Mesh) -> np.ndarray:
    """Number of face corners of each polygon, (P,) i32; those of all polygons follow each other."""
    sizes = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", sizes)
    return sizes


def polygon_slots(mesh: bpy.types.Mesh) -> np.ndarray:
    """Material slot of each polygon, (P,) i32."""
    slots = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", slots)
    return slots


def transform_points(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points (N,3) moved by an affine 4x4 matrix."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def world_positions(item: bpy.types.Object) -> np.ndarray:
    """(V,3) f64 vertices of a mesh object in the world."""
    return transform_points(vertex_positions(item.data), np.array(item.matrix_world, np.float64))


def area_normals(corners: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(P,3) normals of polygons, as long as twice their areas (Newell).

    Args:
        corners: (L,3) positions of the face corners, those of each polygon after the other.
        starts: (P,) first face corner of each polygon.
    """
    sizes = np.diff(starts, append=len(corners))
    following = np.arange(len(corners)) + 1
    following[starts + sizes - 1] = starts
    first = corners[np.repeat(starts, sizes)]
    return np.add.reduceat(np.cross(corners - first, corners[following] - first), starts, axis=0)


def remove_polygons(mesh: bpy.types.Mesh, chosen: np.ndarray) -> None:
    """Remove polygons, (P,) bool, with the edges and vertices that only they have."""
    bm = bmesh.new()
    bm.from_mesh(mesh)
    faces = [face for face, unwanted in zip(bm.faces, chosen.tolist(), strict=True) if unwanted]
    bmesh.ops.delete(bm, geom=faces, context="FACES")
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()


def world_bounds(objects: Iterable[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest corner (3,) of the objects' bounding boxes in the world; None without objects."""
    corners = [item.matrix_world @ Vector(corner) for item in objects for corner in item.bound_box]
    if not corners:
        return None
    points = np.array(corners)
    return points.min(axis=0), points.max(axis=0)


def barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,3) weights of the corners of triangles (N,3,3) at points (N,3) on them, none negative."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    offset = points - triangles[:, 0]
    a, b, c = (first * first).sum(1), (first * second).sum(1), (second * second).sum(1)
    d, e = (offset * first).sum(1), (offset * second).sum(1)
    area = np.maximum(a * c - b * b, 1e-300)
    v, w = np.maximum((c * d - b * e) / area, 0.0), np.maximum((a * e - b * d) / area, 0.0)
    weights = np.stack([np.maximum(1.0 - v - w, 0.0), v, w], axis=1)
    return weights / weights.sum(axis=1, keepdims=True)
