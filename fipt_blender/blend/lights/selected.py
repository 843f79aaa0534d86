"""A light that is selected in a 3D viewport becomes the active row of the list of lights. Imported while
Blender starts: needs bpy alone.
"""

from __future__ import annotations

import bpy

from ..marks import FIXTURE_LIGHT

_owner = object()  # of the subscription


def register() -> None:
    """Watch the active object; nothing in background."""
    if not bpy.app.background:
        _subscribe()
        bpy.app.handlers.load_post.append(_subscribe)


def unregister() -> None:
    """Stop watching."""
    if not bpy.app.background:
        bpy.msgbus.clear_by_owner(_owner)
        bpy.app.handlers.load_post.remove(_subscribe)


@bpy.app.handlers.persistent
def _subscribe(*_: object) -> None:
    bpy.msgbus.clear_by_owner(_owner)
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"), owner=_owner, args=(), notify=follow_selection
    )


def follow_selection() -> None:
    """Make the row of the active object, or of the fixture that it stands for, the active one."""
    context = bpy.context
    item = context.view_layer.objects.active if context.view_layer else None
    if item is not None and FIXTURE_LIGHT in item:
        item = item.parent
    settings = context.scene.fipt.lights
    for index, row in enumerate(settings.lights):
        if item is not None and row.object == item and index != settings.active:
            from ..capture.look import redraw_views

            settings.active = index
            redraw_views()
