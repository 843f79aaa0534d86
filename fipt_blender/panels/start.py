# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Start: the engine, then the example or a folder of the artist's own."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..jobs import running
from . import engine, path
from .capture import FIPT_PT_capture_import, draw_import
from .job import draw_job, draw_warnings, job_warnings
from .presets import FIPT_PT_import_presets
from .sidebar import Section, SubSection, draw_text


class FIPT_PT_start(Section, bpy.types.Panel):
    """The first steps: set up the engine, then try the example or choose a folder"""

    bl_label = "Start"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        job = running.current()
        if not machine.has_engine() or (job is not None and job.kind == running.DATA_KIND):
            engine.draw_set_up(layout, context)
            return
        if draw_job(layout, context, "estimate"):  # the example, before its views are there
            return
        settings = context.scene.fipt.capture
        column = layout.column()
        column.scale_y = 1.4
        column.operator("fipt.try_example", icon="HOME")
        text = iface_("Or choose a folder: photographs, a capture with cameras, or the data of a scan.")
        draw_text(layout, context, text)
        column = layout.column(align=True)
        column.prop(settings, "path", text="Folder")
        if settings.path:
            column.operator("fipt.import_capture", icon="IMPORT")
        else:
            column.operator("fipt.choose_capture", text="Choose Folder...", icon="FILEBROWSER")
        if any(item.type == "CAMERA" and item.data.background_images for item in context.scene.objects):
            layout.operator("fipt.use_scene_cameras", icon="CAMERA_DATA")
        draw_import(layout, context)
        draw_warnings(layout, context, "capture", job_warnings(context, "capture"))


class FIPT_PT_start_import(SubSection, bpy.types.Panel):
    """Options for reading the capture"""

    bl_label = "Import Settings"
    bl_parent_id = "FIPT_PT_start"
    presets = FIPT_PT_import_presets
    draw = FIPT_PT_capture_import.draw

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return machine.has_engine() and not path.has_views(context)
