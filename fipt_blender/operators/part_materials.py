# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on the materials of parts: pick a part, select its faces, reset its adjustment, make assets."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .pointer import PicksAlongRay
from .polls import all_of, has_results, in_object_mode, needs
from .reporting import reports_errors


class _NeedsParts:
    """Mix-in of operators on the list of parts."""

    poll = all_of(
        has_results,
        in_object_mode,
        needs(
            lambda context: context.scene.fipt.materials.parts,
            "Apply the results again: they have no parts yet",
        ),
        needs(
            lambda context: context.scene.fipt.materials.shown != "ORIGINAL", "Choose Estimated as Show first"
        ),
    )


class FIPT_OT_pick_part(_NeedsParts, PicksAlongRay, bpy.types.Operator):
    """Click on the room to choose the part under the mouse pointer"""

    bl_idname = "fipt.pick_part"
    bl_label = "Pick Part"
    bl_options = {"REGISTER", "UNDO"}
    pick_text = "Click: Choose the Part   Esc, Right Click: Cancel"

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


class FIPT_OT_select_part_faces(_NeedsParts, bpy.types.Operator):
    """Select the faces of the active part in Edit Mode"""

    bl_idname = "fipt.select_part_faces"
    bl_label = "Select Faces"
    bl_options = {"REGISTER", "UNDO"}

    edit: bpy.props.BoolProperty(
        name="Edit Mode", description="Switch to Edit Mode, which shows the selected faces", default=True
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.part_list import select_faces

        part = context.scene.fipt.materials.part()
        if part is None:
            self.report({"ERROR"}, "Choose a part in the list first.")
            return {"CANCELLED"}
        select_faces(context.scene, context.view_layer, part.key)
        if self.edit:
            context.tool_settings.mesh_select_mode = (False, False, True)
            bpy.ops.object.mode_set(mode="EDIT")
        return {"FINISHED"}


class FIPT_OT_reset_part(_NeedsParts, bpy.types.Operator):
    """Remove the adjustment of the active part, or of all parts"""

    bl_idname = "fipt.reset_part"
    bl_label = "Reset Adjustment"
    bl_options = {"REGISTER", "UNDO"}

    all_parts: bpy.props.BoolProperty(name="All Parts", description="Remove the adjustments of all parts")

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.part_list import reset_adjustments

        settings = context.scene.fipt.materials
        keys = [row.key for row in settings.parts] if self.all_parts else [settings.active_part_key()]
        count = reset_adjustments(context.scene, keys)
        self.report({"INFO"}, iface_("{} adjustments removed").format(count))
        return {"FINISHED"}


class FIPT_OT_mark_part_assets(_NeedsParts, bpy.types.Operator):
    """Mark the material of the active part, or of all parts, as an asset with a preview"""

    bl_idname = "fipt.mark_part_assets"
    bl_label = "Mark as Asset"
    bl_options = {"REGISTER", "UNDO"}

    all_parts: bpy.props.BoolProperty(name="All Parts", description="Mark the materials of all parts")

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.part_assets import mark_part

        settings = context.scene.fipt.materials
        active = settings.part()
        rows = list(settings.parts) if self.all_parts or active is None else [active]
        count = sum(len(mark_part(context.scene, row)) for row in rows)
        self.report({"INFO"}, iface_("{} materials are assets").format(count))
        return {"FINISHED"}


class FIPT_OT_replace_part_material(_NeedsParts, bpy.types.Operator):
    bl_idname = "fipt.replace_part_material"
    bl_label = "Replace Material"
    bl_description = (
        "Use another material of this file for the whole active part, on all objects on which it lies. A"
        " material that you drop on a face, for example from the asset browser, does the same"
    )
    bl_options = {"REGISTER", "UNDO"}

    material: bpy.props.StringProperty(name="Material", description="Name of the material")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop_search(self, "material", bpy.data, "materials")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.replacing import replace_part
        from ..core.run.errors import FiptError

        part, material = context.scene.fipt.materials.part(), bpy.data.materials.get(self.material)
        if part is None or material is None:
            text = f"There is no material '{self.material}'." if part else "No part is chosen."
            raise FiptError("material-missing", text, "Choose a part in the list and a material of the file.")
        replace_part(context.scene, part.key, material)
        return {"FINISHED"}


class FIPT_OT_restore_estimate(_NeedsParts, bpy.types.Operator):
    """Use the estimated material of the active part again, or of all parts"""

    bl_idname = "fipt.restore_estimate"
    bl_label = "Restore Estimate"
    bl_options = {"REGISTER", "UNDO"}

    all_parts: bpy.props.BoolProperty(name="All Parts", description="Restore the materials of all parts")

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.replacing import replace_part, replacement

        scene, settings = context.scene, context.scene.fipt.materials
        keys = [row.key for row in settings.parts] if self.all_parts else [settings.active_part_key()]
        replaced = [key for key in keys if replacement(scene, key) is not None]
        for key in replaced:
            replace_part(scene, key, None)
        self.report({"INFO"}, iface_("{} estimated materials restored").format(len(replaced)))
        return {"FINISHED"}
