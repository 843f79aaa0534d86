# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Render: pictures of the room, the report."""

from __future__ import annotations

import os

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import RESOLUTION
from .capture import draw_photograph
from .job import draw_job, draw_warnings, job_warnings
from .sidebar import Section, draw_text


class FIPT_PT_check(Section, bpy.types.Panel):
    """Render pictures of the room, and write the report"""

    bl_label = "Render"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.check
        _draw_picture(layout, context, settings)
        layout.separator()
        row = layout.row(align=True)
        row.operator("fipt.write_report", icon="FILE_TEXT")
        row.operator("fipt.open_report", text="", icon="URL")
        draw_job(layout, context, "report")
        draw_warnings(layout, context, "check", job_warnings(context, "report"))


def _draw_picture(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup
) -> None:
    """The picture of the current view: with the rendered room, or over the photograph."""
    insert = context.scene.fipt.insert
    row = layout.row(align=True)
    row.operator("fipt.add_ball", text="Gray Ball", icon="SPHERE").kind = "GRAY_BALL"
    row.operator("fipt.add_ball", text="Mirror Ball", icon="SHADING_RENDERED").kind = "MIRROR_BALL"
    row = layout.row(align=True)
    for mode, text, icon in (("ROOM", "Rendered Room", "HOME"), ("PHOTOGRAPH", "Photograph", "IMAGE_DATA")):
        row.operator("fipt.set_backdrop", text=text, icon=icon, depress=insert.backdrop == mode).mode = mode
    if insert.backdrop == "PHOTOGRAPH":
        shading = getattr(context.space_data, "shading", None)
        if shading is not None and shading.type != "RENDERED":
            row = layout.row()
            row.use_property_split = False
            row.prop_enum(shading, "type", "RENDERED", text="Preview Shadows")
        text = "The picture has the lights as they were photographed, and those that you added."
        draw_text(layout, context, text, icon="INFO")
    else:
        draw_photograph(layout, context.scene.fipt.capture)
    _draw_settings(layout, context, settings, insert.backdrop == "PHOTOGRAPH")
    row = layout.row(align=True)
    row.scale_y = 1.3
    row.operator("fipt.final_picture", icon="RENDER_STILL")
    row.operator("fipt.open_picture", text="", icon="WINDOW")
    if insert.backdrop == "PHOTOGRAPH":
        row.operator("fipt.plate_nodes", text="", icon="NODE_COMPOSITING")
    if insert.picture:
        layout.label(text=os.path.basename(insert.picture), icon="CHECKMARK", translate=False)


def _draw_settings(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup, plate: bool
) -> None:
    """Blender's own render settings on which pictures depend most; a plate keeps its proportions."""
    from ..blend.pictures.renders import output_size, plate_size
    from ..blend.render_settings import changed_by_artist

    scene = context.scene
    plate = plate and scene.camera is not None and RESOLUTION in scene.camera
    column = layout.column(align=True)
    column.prop(settings, "size")
    column.prop(scene.render, "resolution_percentage", text="Scale")
    size = plate_size(scene, scene.camera) if plate else output_size(scene)
    text = "{} x {} pixels over the photograph" if plate else "{} x {} pixels, also with F12"
    column.label(text=iface_(text).format(*size), translate=False)
    if hasattr(scene, "cycles"):
        column = layout.column(align=True)
        column.prop(scene.cycles, "adaptive_threshold", text="Noise Threshold")
        column.prop(scene.cycles, "samples", text="Max Samples")
    if changed_by_artist(scene):
        row = layout.row()
        row.label(text="Render settings: yours", icon="USER")
        row.operator("fipt.set_rendering", text="", icon="LOOP_BACK")
