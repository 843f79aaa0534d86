"""Which side of an imported surface is its front: the one that the cameras see.

Viewports hide surfaces from behind, and lamps shine from their fronts.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector

from ..marks import all_view_cameras
from ..room.islands import connected_triangles
from ..room.mesh_arrays import corner_vertices, polygon_sizes, triangle_loops, world_positions
from ..room.rays import corner_tree
from .mesh_import import ordered_normals

# Cameras, and triangles of a surface and of a mesh, between which rays are cast, at most.
_EYES, _TARGETS, _ALL_TARGETS = 24, 24, 8000
_ARRIVED = 1e-3  # distance of a ray's end from its target, as a share of that from the eye, at most


def face_cameras(scene: bpy.types.Scene, items: Sequence[bpy.types.Object]) -> None:
    """Turn those connected surfaces of new meshes of which cameras see more of the back than of the front."""
    bpy.context.view_layer.update()
    cameras = all_view_cameras(scene)
    if not cameras or not items:
        return
    some = np.unique(np.linspace(0, len(cameras) - 1, _EYES).astype(int)).tolist()
    eyes = [cameras[index].matrix_world.translation.copy() for index in some]
    meshes = [_surfaces(item) for item in items]
    tree = corner_tree(np.concatenate([corners for corners, *_ in meshes]))
    for item, (corners, surface, polygon) in zip(items, meshes, strict=True):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        order = np.lexsort((-area, surface))  # the largest triangles of each surface first
        start = np.searchsorted(surface[order], surface[order])
        votes = np.zeros(int(surface.max(initial=-1)) + 1, np.int64)
        targets = order[np.arange(len(order)) - start < _TARGETS]
        for triangle in targets[np.argsort(-area[targets], kind="stable")[:_ALL_TARGETS]].tolist():
            target, front = Vector(corners[triangle].mean(axis=0)), Vector(normal[triangle])
            for eye in eyes:
                toward = target - eye
                end, *_ = tree.ray_cast(eye, toward)
                if end is not None and (end - target).length < _ARRIVED * toward.length:
                    votes[surface[triangle]] += 1 if front.dot(toward) < 0.0 else -1
        turned = np.isin(np.arange(len(item.data.polygons)), polygon[votes[surface] < 0])
        if turned.any():
            _turn(item.data, turned)


def _surfaces(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of T triangles of a mesh: corners (T, 3, 3) in the world, (T,) connected surface and (T,) polygon."""
    loops, polygon = triangle_loops(item.data, False)
    positions = world_positions(item)
    _, place = np.unique(np.round(positions, 6), axis=0, return_inverse=True)
    vertices = corner_vertices(item.data)[loops]
    return positions[vertices], connected_triangles(place.ravel()[vertices]), polygon


def _turn(mesh: bpy.types.Mesh, turned: np.ndarray) -> None:
    """Reverse polygons, (P,) bool, with their shading normals."""
    _, normals = ordered_normals(mesh)
    sizes = polygon_sizes(mesh)
    is_custom = mesh.has_custom_normals
    for index in np.flatnonzero(turned).tolist():
        mesh.polygons[index].flip()
    if is_custom:  # the corners of a polygon follow each other before and after
        signs = np.repeat(np.where(turned, -1.0, 1.0), sizes)[:, None]
        restored = np.empty_like(normals)
        restored[ordered_normals(mesh)[0]] = normals * signs
        mesh.normals_split_custom_set(restored.astype(np.float32).tolist())
    mesh.update()
