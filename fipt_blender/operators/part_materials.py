# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on the materials of parts: pick a part, select its faces, reset its adjustment, make assets."""

from __future__ import annotations

from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.errors import FiptError
from .action import action, dialog
from .pointer import PicksAlongRay
from .polls import all_of, has_results, in_object_mode, needs

_has_parts = (
    has_results,
    in_object_mode,
    needs(
        lambda context: context.scene.fipt.materials.parts,
        "Apply the results again: they have no parts yet",
    ),
    needs(lambda context: context.scene.fipt.materials.shown != "ORIGINAL", "Choose Estimated as Show first"),
)
AllParts = Annotated[bool, "All parts instead of the active one"]


class FIPT_OT_pick_part(PicksAlongRay, bpy.types.Operator):
    """Click on the room to choose the part under the mouse pointer"""

    bl_idname = "fipt.pick_part"
    bl_label = "Pick Part"
    bl_options = {"REGISTER", "UNDO"}
    pick_text = "Click: Choose the Part   Esc, Right Click: Cancel"

    poll = all_of(*_has_parts)

    def take_click(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        super().take_click(context, event)
        if self._part_hit(context) is None:
            self.report({"INFO"}, "There is no estimated surface under the mouse pointer")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        index = self._part_hit(context)
        if index is None:
            self.report({"WARNING"}, "The ray hits no estimated surface")
            return {"CANCELLED"}
        context.scene.fipt.materials.active_part = index
        if context.area is not None:
            context.area.tag_redraw()
        return {"FINISHED"}

    def _part_hit(self, context: bpy.types.Context) -> int | None:
        """Row of the part that the ray hits; None without one."""
        from ..blend.results.part_list import part_under

        key = part_under(context.scene, context.evaluated_depsgraph_get(), *self.ray())
        rows = context.scene.fipt.materials.parts
        return next((i for i, row in enumerate(rows) if key and row.key == key), None)


@action("Select Faces", needs=_has_parts)
def select_part_faces(
    context: bpy.types.Context,
    edit: Annotated[bool, "Switch to Edit Mode, which shows the selected faces"] = True,
) -> None:
    """Select the faces of the active part in Edit Mode."""
    from ..blend.results.part_list import select_faces

    part = context.scene.fipt.materials.part()
    if part is None:
        raise FiptError("part-missing", "No part is chosen.", "Choose a part in the list first.")
    select_faces(context.scene, context.view_layer, part.key)
    if edit:
        context.tool_settings.mesh_select_mode = (False, False, True)
        bpy.ops.object.mode_set(mode="EDIT")


@action("Reset Adjustment", needs=_has_parts)
def reset_part(scene: bpy.types.Scene, all_parts: AllParts = False) -> str:
    """Remove the adjustment of the active part, or of all parts."""
    from ..blend.results.part_list import reset_adjustments

    return iface_("{} adjustments removed").format(reset_adjustments(scene, _keys(scene, all_parts)))


@action("Mark as Asset", needs=_has_parts)
def mark_part_assets(scene: bpy.types.Scene, all_parts: AllParts = False) -> str:
    """Mark the material of the active part, or of all parts, as an asset with a preview."""
    from ..blend.results.part_assets import mark_part

    settings = scene.fipt.materials
    active = settings.part()
    rows = list(settings.parts) if all_parts or active is None else [active]
    return iface_("{} materials are assets").format(sum(len(mark_part(scene, row)) for row in rows))


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
        raise FiptError("material-missing", text, "Choose a part in the list and a material of the file.")
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
