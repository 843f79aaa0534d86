# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Materials: applies the results to the room and shows their maps."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..jobs import running, runstate
from . import swatches
from .job import draw_job, draw_warnings, job_warnings
from .lights import draw_engine_choice
from .sidebar import Rows, Section, SubSection, draw_text


class FIPT_PT_materials(Section, bpy.types.Panel):
    """Apply the estimated materials and lights, and show their maps"""

    bl_label = "Materials"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.materials
        draw_job(layout, context, "materials")
        if settings.object_count:
            _draw_results(layout, context, settings)
        draw_warnings(layout, context, "materials", job_warnings(context, "materials"))


class FIPT_UL_part_materials(Rows, bpy.types.UIList):
    """The parts of the room: mean base color, name, and whether its material is adjusted"""

    def draw_row(self, context: Context, layout: UILayout, item: PropertyGroup, index: int) -> None:
        layout.use_property_split = False
        # An icon: a color field can't be disabled without a tint.
        color = item.base_color.copy()  # of a property itself, Blender 4.3 converts zeros
        red, green, blue = (round(value, 2) for value in color.from_scene_linear_to_srgb())
        layout.label(text=item.name, icon_value=swatches.icon((red, green, blue)), translate=False)


class FIPT_PT_materials_parts(Section, bpy.types.Panel):
    """Adjust the estimated material of a part of the room"""

    bl_label = "Materials of Parts"
    bl_parent_id = "FIPT_PT_materials"
    bl_order = 0  # and open: what one needs after Apply Results

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.fipt.materials.object_count)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.materials
        row = layout.row()
        row.template_list("FIPT_UL_part_materials", "", settings, "parts", settings, "active_part", rows=5)
        column = row.column(align=True)
        column.operator("fipt.pick_part", text="", icon="EYEDROPPER")
        part = settings.part()
        if part is None:
            return
        if part.known:
            text = iface_("Estimated: roughness {:.2f}, metallic {:.2f}; {:,} pixels")
            text = text.format(part.roughness, part.metallic, part.pixels)
        else:
            text = iface_("No mean values for this part; {:,} faces").format(part.faces)
        draw_text(layout, context, text)
        replaced = _draw_replacement(layout, context, part)
        column = layout.column(align=True)
        column.enabled = settings.shown != "ORIGINAL" and not replaced
        if part.known:
            row = column.row(align=True)
            row.prop(part, "color")
            row.operator("fipt.set_part_color", text="", icon="EYEDROPPER")
        for name in _SLIDERS:
            column.prop(part, _SUMS.get(name, name) if part.known else name, slider=True)
        shading = getattr(context.space_data, "shading", None)
        changed = any(getattr(part, name) != neutral for name, neutral in _SLIDERS.items())
        changed |= part.known and part.color != part.base_color
        if changed and shading is not None and shading.type == "SOLID":
            text = "Solid shading shows the textures without these changes. Use Material Preview or Rendered."
            draw_text(layout, context, iface_(text), icon="INFO")


class FIPT_PT_materials_parts_more(SubSection, bpy.types.Panel):
    """What else can be done with the active part"""

    bl_label = "More"
    bl_parent_id = "FIPT_PT_materials_parts"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("fipt.select_part_faces", icon="FACESEL")
        column.operator("fipt.reset_part", icon="LOOP_BACK").all_parts = False
        column.operator("fipt.mark_part_assets", icon="ASSET_MANAGER").all_parts = False


class FIPT_PT_materials_emptying(SubSection, bpy.types.Panel):
    """The room without some of its furniture"""

    bl_label = "Empty the Room"
    bl_parent_id = "FIPT_PT_materials"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("fipt.remove_from_room", icon="TRASH")
        column.operator("fipt.bring_back", icon="LOOP_BACK")


class FIPT_PT_materials_hand_off(SubSection, bpy.types.Panel):
    """The room for other programs and machines"""

    bl_label = "Hand Off"
    bl_parent_id = "FIPT_PT_materials"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("fipt.export_room", text="Export Room...", icon="EXPORT")
        column.operator("fipt.collect_room", text="Collect Room...", icon="PACKAGE")


class FIPT_PT_materials_settings(SubSection, bpy.types.Panel):
    """Textures, and what else Apply Results changes"""

    bl_label = "Apply Settings"
    bl_parent_id = "FIPT_PT_materials"
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.materials
        column = layout.column()
        column.enabled = running.current() is None
        column.prop(settings, "atlas_mode")
        if settings.atlas_mode == "uv":
            column.prop(settings, "atlas_images")
            column.prop(settings, "texture_size")
            column.prop(settings, "texel_density")
        if settings.atlas_mode == "uv":
            column.prop(settings, "texture_format")
        column.prop(settings, "write_back")
        column.prop(settings, "clean_mesh")
        column = layout.column(heading="Scene")
        column.enabled = running.current() is None
        column.prop(settings, "mute_lights")
        column.prop(settings, "set_rendering")
        layout.operator("fipt.apply_results", text="Apply Again", icon="MATERIAL")
        layout.operator("fipt.revert", icon="LOOP_BACK")


def _draw_results(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup
) -> None:
    """What is shown of the results, and what can be done with them."""
    column = layout.column()
    column.enabled = context.mode == "OBJECT"
    column.prop(settings, "shown")
    text = "{} objects, {} images" if settings.applied_mode == "uv" else "{} objects with attributes"
    text = iface_(text).format(settings.object_count, 4 * settings.image_count)
    layout.label(text=text, icon="CHECKMARK", translate=False)
    _draw_pictures(layout, context)
    if settings.shown == "ESTIMATED":
        _draw_preview(layout, context)
        if context.scene.fipt.lights.needs_cycles():
            draw_engine_choice(layout, context)


def _draw_pictures(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Pictures that are missing, and what helps."""
    missing = runstate.known(context.scene.fipt.run_folder).missing
    if missing:
        text = iface_("{} pictures of the results are missing, such as {}").format(len(missing), missing[0])
        draw_text(layout, context, text, icon="ERROR", alert=True)
        layout.operator("file.find_missing_files", icon="VIEWZOOM")


def _draw_preview(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Rendered shading, where the viewport shows the textures alone."""
    shading = getattr(context.space_data, "shading", None)
    if shading is not None and shading.type in ("SOLID", "WIREFRAME"):
        row = layout.row()
        row.use_property_split = False
        row.prop_enum(shading, "type", "RENDERED", text="Preview Light")


# The adjustments, and where they change nothing; of parts with mean values, sliders show the sums.
_SLIDERS = {"roughness_offset": 0.0, "metallic_offset": 0.0, "hue": 0.0, "saturation": 1.0, "value": 1.0}
_SUMS = {"roughness_offset": "roughness_value", "metallic_offset": "metallic_value"}


def _draw_replacement(
    layout: bpy.types.UILayout, context: bpy.types.Context, part: bpy.types.PropertyGroup
) -> bool:
    """The material that replaces that of a part; returns whether there is one."""
    from ..blend.results.replacing import replacement

    material = replacement(context.scene, part.key)
    row = layout.row(align=True)
    if material is None:
        row.operator("fipt.replace_part_material", text="Replace Material...", icon="MATERIAL")
        return False
    row.operator("fipt.replace_part_material", text=material.name, icon="MATERIAL", translate=False)
    row.operator("fipt.restore_estimate", icon="LOOP_BACK").all_parts = False
    return True
