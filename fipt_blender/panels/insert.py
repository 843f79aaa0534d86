# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Insert: places objects in the room and renders pictures of them."""

from __future__ import annotations

import os

import bpy

from .job import draw_job, draw_warnings, job_warnings
from .sidebar import Section, SubSection, draw_text


class FIPT_PT_insert(Section, bpy.types.Panel):
    """Place objects in the room"""

    bl_label = "Insert"
    bl_order = 6

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.insert
        column = layout.column(align=True)
        column.prop(settings, "kind")
        if settings.kind == "OBJECT":
            column.prop(settings, "object")
            column.prop(settings, "copy")
        elif settings.kind == "COLLECTION":
            column.prop(settings, "collection")
        row = layout.row(align=True)
        row.prop(settings, "align", expand=True)
        column = layout.column(align=True)
        column.prop(settings, "turn")
        column.prop(settings, "scale")
        column.prop(settings, "drop")
        row = layout.row(align=True)
        row.scale_y = 1.3
        row.operator("fipt.insert_object", icon="CURSOR")
        row.operator("fipt.remove_inserted", text="", icon="TRASH")


class FIPT_PT_insert_picture(SubSection, bpy.types.Panel):
    """Render the current view with the inserted objects"""

    bl_label = "Picture"
    bl_parent_id = "FIPT_PT_insert"
    bl_options = set()

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.insert
        row = layout.row(align=True)
        for mode, text, icon in (
            ("ROOM", "Rendered Room", "HOME"),
            ("PHOTOGRAPH", "Photograph", "IMAGE_DATA"),
        ):
            row.operator(
                "fipt.set_backdrop", text=text, icon=icon, depress=settings.backdrop == mode
            ).mode = mode
        shading = context.space_data.shading
        if settings.backdrop == "PHOTOGRAPH":
            if shading.type != "RENDERED":
                row = layout.row()
                row.use_property_split = False
                row.prop_enum(shading, "type", "RENDERED", text="Preview Shadows")
            text = "The viewport previews shadows. Reflections in the room appear only in the picture."
            draw_text(layout, context, text, icon="INFO")
        layout.prop(settings, "samples")
        row = layout.row(align=True)
        text = "Render into Photograph" if settings.backdrop == "PHOTOGRAPH" else "Render View"
        row.operator("fipt.render_composite", text=text, icon="RENDER_STILL")
        row.operator("fipt.open_picture", text="", icon="WINDOW")
        draw_job(layout, context, "insert")
        if settings.picture:
            layout.label(text=os.path.basename(settings.picture), icon="CHECKMARK", translate=False)
        draw_warnings(layout, context, "insert", job_warnings(context, "insert"))


CLASSES = (FIPT_PT_insert, FIPT_PT_insert_picture)
