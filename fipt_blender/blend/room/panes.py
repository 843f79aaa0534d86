"""The objects of what the engine has added to a scan, beside those of the room."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.run.run_files import CLOSING, PANES, RoomMesh
from ..marks import ADDED, CLOSED, FOUND, OBJECT_ID, object_id
from .islands import connected_triangles


def add_surfaces(room: RoomMesh, objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Add the run's closed holes and panes to the scene's room, where the scene does not have them already.

    The new objects have the collections and the parent of the room's first object, which they move with.

    Args:
        room: the run's room.
        objects: the scene's room.
    """
    meshes = [item for item in objects if item.type == "MESH"]
    present = set(map(object_id, meshes))
    wanted = [name for name in (CLOSING, PANES) if name in room.object_ids and name not in present]
    added = []
    for name in wanted if meshes else []:
        of_object = np.flatnonzero(room.triangle_object == room.object_ids.index(name))
        added.append(_new_object(room, of_object, name, meshes[0]))
        added[-1][OBJECT_ID] = name
    return added


def add_apart(room: RoomMesh, index: int, beside: bpy.types.Object) -> list[bpy.types.Object]:
    """Add an object that the engine has added to a room, one for each surface, so that each can be edited.

    Args:
        index: of the object. beside: as the room's first object of `add_surfaces`.
    """
    of_object = np.flatnonzero(room.triangle_object == index)
    name = room.objects[index]
    if name == CLOSING:
        added = [_new_object(room, of_object, name, beside)]
        added[0][OBJECT_ID] = name
        return added
    piece = connected_triangles(room.triangles[of_object])
    rows = [of_object[piece == number] for number in range(int(piece.max(initial=-1)) + 1)]
    return [_new_object(room, each, "FIPT Added", beside) for each in rows]


def link_beside(item: bpy.types.Object, beside: bpy.types.Object) -> None:
    """Give a new object, whose place is in the world, the collections and the parent of another one."""
    for collection in beside.users_collection:
        collection.objects.link(item)
    if beside.parent is not None:
        item.parent = beside.parent
        item.matrix_parent_inverse = beside.parent.matrix_world.inverted()


def _new_object(
    room: RoomMesh, of_object: np.ndarray, name: str, beside: bpy.types.Object
) -> bpy.types.Object:
    """An object with some triangles (n,) of a room, and their normals."""
    used, corners = np.unique(room.triangles[of_object], return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(room.vertices[used].tolist(), [], corners.reshape(-1, 3).tolist())
    mesh.shade_smooth()
    mesh.normals_split_custom_set(room.corner_normals[of_object].reshape(-1, 3).tolist())
    added = bpy.data.objects.new(name, mesh)
    added[ADDED] = CLOSED if name == CLOSING else FOUND
    link_beside(added, beside)
    return added
