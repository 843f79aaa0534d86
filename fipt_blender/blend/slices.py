"""Work on Blender's data in slices: generators that yield so that windows can redraw in between.

Between two slices the artist may undo, rename or load a file; so a generator keeps names, not Blender's data.
"""

from __future__ import annotations

import bpy

from ..core.run.errors import FiptError


def find_object(name: str) -> bpy.types.Object:
    """An object of an earlier slice, by name."""
    item = bpy.data.objects.get(name)
    if item is None:
        raise FiptError("room-changed.find-object", name=name)
    if item.mode == "EDIT":
        raise FiptError("room-edited.find-object", name=name)
    return item
