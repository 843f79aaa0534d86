# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Materials: applies the results to the room and shows their maps."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..jobs import running
from .job import draw_job
from .sidebar import Section, draw_text


class FIPT_PT_materials(Section, bpy.types.Panel):
    """Apply the estimated materials and lights, and show their maps"""

    bl_label = "Materials"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.materials
        column = layout.column()
        column.enabled = running.current() is None
        column.prop(settings, "atlas_mode")
        if settings.atlas_mode == "uv":
            column.prop(settings, "texture_size")
            column.prop(settings, "texel_density")
        column.prop(settings, "texture_files")
        column.prop(settings, "write_back")
        column.prop(settings, "clean_mesh")
        column = layout.column(heading="Scene")
        column.enabled = running.current() is None
        column.prop(settings, "match_exposure")
        column.prop(settings, "mute_lights")
        column.prop(settings, "use_cycles")
        row = layout.row()
        row.scale_y = 1.4
        row.operator("fipt.apply_results", icon="MATERIAL")
        draw_job(layout, context, "materials")
        if not settings.object_count:
            return
        layout.separator()
        column = layout.column()
        column.enabled = context.mode == "OBJECT"
        column.prop(settings, "shown")
        text = "{} objects, {} images" if settings.applied_mode == "uv" else "{} objects with attributes"
        text = iface_(text).format(settings.object_count, 4 * settings.image_count)
        layout.label(text=text, icon="CHECKMARK", translate=False)
        if settings.shown == "ESTIMATED" and context.scene.fipt.lights.needs_cycles():
            text = "EEVEE renders no light from the lamps' surfaces: the room is dark."
            draw_text(layout, context, iface_(text), icon="ERROR")
            layout.operator("fipt.use_cycles", icon="SHADING_RENDERED")
        layout.operator("fipt.revert", icon="LOOP_BACK")


CLASSES = (FIPT_PT_materials,)
