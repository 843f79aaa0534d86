# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects of what the engine has added to a scan, beside those of the room: closed holes and panes."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.run.run_files import CLOSING, PANES
from ..marks import OBJECT_ID, object_id
from .arrays import Room


def add_surfaces(room: Room, objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Add the run's closed holes and panes to the scene's room, where the scene does not have them already.

    The new objects have the collections and the parent of the room's first object, which they move with.

    Args:
        room: the run's room.
        objects: the scene's room.
    """
    meshes = [item for item in objects if item.type == "MESH"]
    present = set(map(object_id, meshes))
    wanted = [name for name in (CLOSING, PANES) if name in room.object_ids and name not in present]
    return [_new_object(room, name, meshes[0]) for name in wanted] if meshes else []


def _new_object(room: Room, name: str, beside: bpy.types.Object) -> bpy.types.Object:
    triangles = room.triangles[room.triangle_object == room.object_ids.index(name)]
    used, corners = np.unique(triangles, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(room.vertices[used].tolist(), [], corners.reshape(-1, 3).tolist())
    added = bpy.data.objects.new(name, mesh)
    added[OBJECT_ID] = name
    for collection in beside.users_collection:
        collection.objects.link(added)
    if beside.parent is not None:
        added.parent = beside.parent
        added.matrix_parent_inverse = beside.parent.matrix_world.inverted()
    return added
