"""Operators of the section Materials: apply results, show their maps, revert; the materials of parts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..core.run.declared import Option
from ..core.run.errors import FiptError, warning
from ..jobs.tasks import Task
from ..properties.materials import SHOWN
from .action import Messages, action, dialog, file_dialog, note
from .pointer import PicksAlongRay, PointerRay
from .polls import has_results, in_object_mode, is_own_room, needs, no_job


@action(
    "Apply Results",
    needs=(
        no_job,
        needs(lambda context: context.scene.fipt.run_folder, "Run Estimate first"),
        is_own_room,
        in_object_mode,
    ),
)
def apply_results(scene: bpy.types.Scene) -> Task:
    """Apply the estimated materials and lights to the room. Your own meshes, materials and world are set
    aside; Revert restores them.
    """
    return applying.application()


@action("Show Map", needs=(has_results, in_object_mode), bl_property="shown", listed=False)
def show_map(
    scene: bpy.types.Scene,
    shown: Annotated[str, Option("What the room shows", "Show", choices=SHOWN)] = "ESTIMATED",
) -> None:
    """Show one of the estimated maps, the estimated materials or the original state on the whole room."""
    scene.fipt.materials.shown = shown


@action("Revert", needs=(has_results, in_object_mode))
def revert(
    scene: bpy.types.Scene,
    new_lights: Annotated[
        bool, Option("Also remove the lights that you added in the section Lights", "Remove New Lights")
    ] = False,
) -> Messages:
    """Remove the results from the room and restore your own meshes, materials and world. The run keeps its
    results, so they can be applied again.
    """
    from ..blend.results import reverting
    from ..blend.room.result_meshes import list_names

    restored, hidden = reverting.revert(scene, new_lights)
    messages = [note(iface_("{} objects restored").format(len(restored)))]
    if hidden:
        messages.insert(0, warning("faces-hidden", objects=list_names(hidden)))
    return messages


@action("Collect Room", needs=(has_results, no_job, in_object_mode), invoke=file_dialog)
def collect_room(
    scene: bpy.types.Scene,
    directory: Annotated[
        str, Option("Where the copy is saved", "Folder", shown={"subtype": "DIR_PATH"})
    ] = "",
) -> Messages:
    """Save a copy of the file into a folder of its own, with all images that it uses. It opens on another
    machine without this add-on. In a folder that is not empty, the folder NAME_collected is made for it.
    """
    from ..blend import collecting

    if not directory:
        raise FiptError("export-file.collect-room")
    path, left = collecting.collect_room(Path(bpy.path.abspath(directory)))
    messages = [note(iface_("{} written").format(path))]
    if left:
        messages.insert(0, warning("files-left", count=len(left), first=left[0]))
    return messages


@action("Switch to Cycles")
def use_cycles(scene: bpy.types.Scene) -> None:
    """Make Cycles the scene's render engine. It renders the light of lamps' surfaces, and light groups."""
    from ..blend.render_settings import set_once

    if not set_once(scene, {"render.engine": "CYCLES"}, again=True):
        raise FiptError("cycles-missing")


_has_parts = (
    has_results,
    in_object_mode,
    needs(
        lambda context: context.scene.fipt.materials.parts, "Apply the results again: they have no parts yet"
    ),
    needs(lambda context: context.scene.fipt.materials.shown != "ORIGINAL", "Choose Estimated as Show first"),
)
AllParts = Annotated[bool, "All parts instead of the active one"]


@action(
    "Pick Part",
    needs=_has_parts,
    bases=(PicksAlongRay,),
    pick_text="Click: Choose the Part   Esc, Right Click: Cancel",
)
def pick_part(context: bpy.types.Context, ray: PointerRay) -> None:
    """Click on the room to choose the part under the mouse pointer."""
    from ..blend.results.part_list import part_under

    key = part_under(context.scene, context.evaluated_depsgraph_get(), *ray)
    rows = context.scene.fipt.materials.parts
    index = next((i for i, row in enumerate(rows) if key and row.key == key), None)
    if index is None:
        raise FiptError("surface-missing.pick-part")
    context.scene.fipt.materials.active_part = index
    if context.area is not None:
        context.area.tag_redraw()


@action("Select Faces", needs=_has_parts)
def select_part_faces(
    context: bpy.types.Context,
    edit: Annotated[bool, "Switch to Edit Mode, which shows the selected faces"] = True,
) -> None:
    """Select the faces of the active part in Edit Mode."""
    from ..blend.results.part_list import select_faces

    part = context.scene.fipt.materials.part()
    if part is None:
        raise FiptError("part-missing.select-part-faces")
    select_faces(context.scene, context.view_layer, part.key)
    if edit:
        context.tool_settings.mesh_select_mode = (False, False, True)
        bpy.ops.object.mode_set(mode="EDIT")


@action("Set Color of Part", needs=_has_parts, invoke=dialog)
def set_part_color(
    scene: bpy.types.Scene,
    color: Annotated[
        str, 'A RAL number, such as "RAL 7035", or sRGB as "#d7d5cb" or "rgb(215, 213, 203)"'
    ] = "",
) -> str:
    """Give the active part a color by its RAL number or its sRGB code. The part's pattern and gloss stay."""
    from ..blend.results.part_colors import named_color

    part = scene.fipt.materials.part()
    if part is None or not part.known:
        raise FiptError("part-missing.set-part-color")
    part.color = named_color(color)
    return iface_("{} has the color {}").format(part.name, color)


@action("Reset Adjustment", needs=_has_parts)
def reset_part(scene: bpy.types.Scene, all_parts: AllParts = False) -> str:
    """Remove the adjustment of the active part, or of all parts."""
    from ..blend.results.part_list import reset_adjustments

    return iface_("{} adjustments removed").format(reset_adjustments(scene, _keys(scene, all_parts)))


@action("Mark as Asset", needs=_has_parts)
def mark_part_assets(scene: bpy.types.Scene, all_parts: AllParts = False) -> str:
    """Make an asset of the active part, or of all parts: a material of its mean values, with a preview.
    The part's textures lie on the room's UVs alone.
    """
    from ..blend.results.part_assets import mark_part

    settings = scene.fipt.materials
    active = settings.part()
    rows = list(settings.parts) if all_parts or active is None else [active]
    return iface_("{} materials are assets").format(sum(mark_part(scene, row) for row in rows))


def _draw_materials(self: Any, context: bpy.types.Context) -> None:
    self.layout.prop_search(self, "material", bpy.data, "materials")


@action("Replace Material", needs=_has_parts, invoke=dialog, draw=_draw_materials)
def replace_part_material(
    scene: bpy.types.Scene, material: Annotated[str, "Name of the material"] = ""
) -> None:
    """Use another material of this file for the whole active part, on all objects on which it lies. A
    material that you drop on a face, for example from the asset browser, does the same.
    """
    from ..blend.results.replacing import replace_part

    part, chosen = scene.fipt.materials.part(), bpy.data.materials.get(material)
    if part is None or chosen is None:
        text = f"There is no material '{material}'." if part else "No part is chosen."
        raise FiptError("material-missing", text=text)
    replace_part(scene, part.key, chosen)


@action("Restore Estimate", needs=_has_parts)
def restore_estimate(scene: bpy.types.Scene, all_parts: AllParts = False) -> str:
    """Use the estimated material of the active part again, or of all parts."""
    from ..blend.results.replacing import replace_part, replacement

    replaced = [key for key in _keys(scene, all_parts) if replacement(scene, key) is not None]
    for key in replaced:
        replace_part(scene, key, None)
    return iface_("{} estimated materials restored").format(len(replaced))


def _keys(scene: bpy.types.Scene, all_parts: bool) -> list[str]:
    settings = scene.fipt.materials
    return [row.key for row in settings.parts] if all_parts else [settings.active_part_key()]
