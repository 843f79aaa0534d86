# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The object of the panes that the engine has put into holes of a scan, beside the objects of the room."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.run.run_files import PANES
from ..marks import OBJECT_ID, object_id
from .arrays import Room


def add_panes(room: Room, objects: Sequence[bpy.types.Object]) -> bpy.types.Object | None:
    """Add the run's panes to the scene's room; None where the run has none, or the scene has them already.

    The new object has the collections and the parent of the room's first object, which it moves with.

    Args:
        room: the run's room.
        objects: the scene's room.
    """
    meshes = [item for item in objects if item.type == "MESH"]
    if PANES not in room.object_ids or not meshes or PANES in map(object_id, meshes):
        return None
    triangles = room.triangles[room.triangle_object == room.object_ids.index(PANES)]
    used, corners = np.unique(triangles, return_inverse=True)
    mesh = bpy.data.meshes.new(PANES)
    mesh.from_pydata(room.vertices[used].tolist(), [], corners.reshape(-1, 3).tolist())
    panes = bpy.data.objects.new(PANES, mesh)
    panes[OBJECT_ID] = PANES
    beside = meshes[0]
    for collection in beside.users_collection:
        collection.objects.link(panes)
    if beside.parent is not None:
        panes.parent = beside.parent
        panes.matrix_parent_inverse = beside.parent.matrix_world.inverted()
    return panes
