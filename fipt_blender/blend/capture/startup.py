"""The cube, light and camera of Blender's start-up file, which would be rendered with the room."""

from __future__ import annotations

import bpy
from mathutils import Vector

from ..marks import STARTUP, remove_marks

# Names, types and places (rounded) in the start-up files of Blender 2.8 to 5.2.
_OBJECTS = {
    "Cube": ("MESH", (0.0, 0.0, 0.0)),
    "Light": ("LIGHT", (4.076, 1.005, 5.904)),
    "Camera": ("CAMERA", (7.359, -6.926, 4.958)),
}


def startup_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Those of the start-up file's objects that nobody has moved, modelled, parented, hidden or chosen."""
    found, room = [], scene.fipt.capture.room_objects(scene)
    for name, (kind, place) in _OBJECTS.items():
        item = scene.objects.get(name)
        if item is None or item.type != kind or item.parent or item.hide_render or item in room:
            continue
        is_cube = kind != "MESH" or (len(item.data.polygons) == 6 and not item.modifiers)
        if is_cube and (item.location - Vector(place)).length < 2e-3:
            found.append(item)
    return found


def hide_startup_objects(scene: bpy.types.Scene, hide: bool = True) -> list[str]:
    """Hide the start-up file's objects in viewports and renders, or show those again that were hidden so.

    Returns:
        Their names.
    """
    items = startup_objects(scene) if hide else [item for item in scene.objects if STARTUP in item]
    for item in items:
        item.hide_viewport = item.hide_render = hide
        if hide:
            item[STARTUP] = 1
        else:
            remove_marks(item, STARTUP)
    return [item.name for item in items]
