"""Where hints are: points on objects, which move with them, and areas of faces.

A fixture is replaced by the next results: hints on it are kept on the object that it was split off.

An area keeps the centers of its triangles in a custom property of the hint, in the object's space, so that it
survives the meshes that results bring.
"""

from __future__ import annotations

import json

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.errors import FiptError
from ...core.run.hints import MOST_POINTS
from ..marks import AREA, FIXTURE_SOURCES, is_split_off, object_id
from ..room.mesh_arrays import corner_vertices, transform_points, triangle_loops, vertex_positions

FACE_SETS = ".sculpt_face_set"


def surface_at_point(scene: bpy.types.Scene, point: Vector) -> tuple[bpy.types.Object, Vector] | None:
    """The scene's mesh object nearest to a point in the world, and its nearest point; None without a mesh."""
    best, least = None, np.inf
    for item in scene.objects:
        if item.type != "MESH" or not len(item.data.polygons) or item.mode != "OBJECT":
            continue
        inverse = item.matrix_world.inverted_safe()
        found, near, _, _ = item.closest_point_on_mesh(inverse @ point)
        distance = ((item.matrix_world @ near) - point).length if found else np.inf
        if distance < least:
            best, least = (item, item.matrix_world @ near), distance
    return best


def kept_object(scene: bpy.types.Scene, item: bpy.types.Object) -> bpy.types.Object:
    """The object on which a hint on another one stays when results are applied."""
    if not is_split_off(item):
        return item
    sources = json.loads(item[FIXTURE_SOURCES])
    return next((other for other in scene.objects if object_id(other) in sources), item)


def face_set_at(item: bpy.types.Object, face: int) -> np.ndarray:
    """(P,) bool, the polygons of an object that are in the face set of one."""
    attribute = item.data.attributes.get(FACE_SETS)
    if attribute is None or attribute.domain != "FACE" or face >= len(item.data.polygons):
        raise FiptError("face-sets-missing", name=item.name)
    values = np.empty(len(item.data.polygons), np.int32)
    attribute.data.foreach_get("value", values)
    result: np.ndarray = values == values[face]
    return result


def selected_faces(item: bpy.types.Object) -> np.ndarray:
    """(P,) bool, the selected polygons of an object in Edit Mode."""
    item.update_from_editmode()
    selected = np.empty(len(item.data.polygons), bool)
    item.data.polygons.foreach_get("select", selected)
    if not selected.any():
        raise FiptError("faces-missing")
    return selected


def set_area(hint: bpy.types.PropertyGroup, item: bpy.types.Object, chosen: np.ndarray) -> None:
    """Make a hint be about polygons of the object that it was added on, (P,) bool."""
    mesh = item.data
    loops, polygon = triangle_loops(mesh, False)
    corners = vertex_positions(mesh)[corner_vertices(mesh)[loops[chosen[polygon]]]]
    if len(corners) > MOST_POINTS:
        raise FiptError("area-large", number_of_corners=len(corners), most_points=MOST_POINTS)
    to_hint = hint.object.matrix_world.inverted_safe() @ item.matrix_world
    centers = transform_points(corners.mean(axis=1), np.array(to_hint, np.float64))
    hint.area, hint.point = True, centers[0]
    hint[AREA] = centers.ravel().tolist()


def world_points(hint: bpy.types.PropertyGroup) -> np.ndarray:
    """(N, 3) points of a hint in the world."""
    stored = hint.get(AREA) if hint.area else None
    points = np.array(hint.point if stored is None else stored, np.float64).reshape(-1, 3)
    return transform_points(points, np.array(hint.object.matrix_world, np.float64))


def in_scene(item: bpy.types.Object | None, scene: bpy.types.Scene) -> bool:
    """Whether an object of a hint still exists in the scene."""
    return item is not None and scene.objects.get(item.name) == item
