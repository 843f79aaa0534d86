"""Operators that remove furniture from the room and bring it back."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import REMOVED
from .action import action
from .polls import has_results, in_object_mode, needs, no_job

_shown = needs(
    lambda context: context.scene.fipt.materials.shown != "ORIGINAL", "Choose Estimated as Show first"
)
_selected = needs(
    lambda context: context.mode == "EDIT_MESH" or (context.mode == "OBJECT" and context.selected_objects),
    "Select furniture, or faces of it in Edit Mode, or an empty of the type Cube around it",
)
_has_removed = needs(
    lambda context: any(REMOVED in item for item in context.scene.objects), "Nothing is removed"
)


@action("Remove from Room", needs=(no_job, has_results, _shown, _selected))
def remove_from_room(context: bpy.types.Context) -> str:
    """Hide the selected furniture, faces, or what lies in the selected empty, and complete the walls, the
    floor and their materials behind it. Its shadow, reflections and lamps go with it. Bring Back shows it
    again.
    """
    from ..api.applying import run_of
    from ..blend.results import emptying

    scene, chosen = context.scene, emptying.Chosen()
    if context.mode == "EDIT_MESH":
        items = list(context.objects_in_mode)
        bpy.ops.object.mode_set(mode="OBJECT")
        chosen |= {item: emptying.selected_faces(item) for item in items}
    else:
        for item in context.selected_objects:
            chosen |= emptying.faces_in_box(scene, item) if item.type == "EMPTY" else {item: None}
    hidden, surfaces = emptying.remove(scene, run_of(scene), chosen)
    return iface_("{} objects removed, {} surfaces completed").format(len(hidden), len(surfaces))


@action("Bring Back", needs=(no_job, has_results, in_object_mode, _has_removed))
def bring_back(context: bpy.types.Context) -> str:
    """Show again what was removed: of the selected completed surfaces, or all if none is selected."""
    from ..blend.results import emptying

    count = emptying.bring_back(context.scene, context.selected_objects)
    return iface_("{} objects are back").format(count)
