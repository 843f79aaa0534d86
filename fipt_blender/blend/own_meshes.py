# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of ours, made from the room's objects as they are evaluated without any results of ours."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ..core.job.errors import FiptError
from .originals import number_polygons, show_original, shows_original
from .room_export import Room, fresh_depsgraph, is_mirrored, triangle_loops


def room_names(room: Room, objects: Iterable[bpy.types.Object]) -> list[str]:
    """The names of a run's objects, in its order, all of which are there.

    Args:
        room: of the run.
        objects: the scene's room.

    Raises:
        FiptError: ``room-changed``.
    """
    here = {item.name for item in objects if item.type == "MESH"}
    missing = [name for name in room.objects if name not in here]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        names = ", ".join(f"'{name}'" for name in missing[:3])
        raise FiptError(
            "room-changed",
            f"The room has no {names}{more} any more: renamed, deleted or taken out of its collection.",
            "Undo that or give it its old name, or estimate again.",
        )
    return list(room.objects)


def make_mesh(room: Room, index: int, item: bpy.types.Object) -> bpy.types.Mesh:
    """A new mesh of ours for one object of the room, evaluated with its modifiers.

    Args:
        room: of the run.
        index: of the object in the room.
        item: the object; it is left as it is.

    Raises:
        FiptError: ``room-changed`` where the faces are not those that were exported.
    """
    ours_shown = not shows_original(item)
    show_original(item, True)
    try:
        depsgraph = fresh_depsgraph([item])
        mesh = bpy.data.meshes.new_from_object(
            item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
        )
    finally:
        if ours_shown:
            show_original(item, False)
    _, polygons = triangle_loops(mesh, is_mirrored(item))
    exported = room.triangle_polygon[room.triangle_object == index]
    if not np.array_equal(polygons, exported):
        bpy.data.meshes.remove(mesh)
        raise FiptError(
            "room-changed",
            f"'{item.name}' has other faces than when the room was estimated"
            f" ({len(polygons):,} triangles instead of {len(exported):,}).",
            "Undo the change to its mesh or modifiers, or estimate again.",
        )
    number_polygons(mesh)
    return mesh
