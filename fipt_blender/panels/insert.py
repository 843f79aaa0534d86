# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Insert: places objects in the room."""

from __future__ import annotations

import bpy

from .sidebar import Section


class FIPT_PT_insert(Section, bpy.types.Panel):
    """Place objects in the room"""

    bl_label = "Insert"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}

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
