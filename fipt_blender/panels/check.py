# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Render: pictures of the room, renders beside their photographs, the report."""

from __future__ import annotations

import os

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.marks import RESOLUTION
from ..properties.check import COMPARISONS
from .capture import shown_name
from .job import draw_job, draw_warnings, job_warnings
from .presets import FIPT_PT_check_presets
from .sidebar import Rows, Section, draw_text


class FIPT_UL_checked_views(Rows, bpy.types.UIList):
    """Rendered views with their PSNR in dB: display values, linear values"""

    def draw_row(self, context: Context, layout: UILayout, item: PropertyGroup, index: int) -> None:
        icon_name = "HIDE_OFF" if item.held_back else "IMAGE_DATA"
        name = shown_name(item.name, context.scene.fipt.capture.name_prefix)
        _draw_row(layout, name, f"{item.psnr:.1f}", f"{item.psnr_linear:.1f}", icon_name)


def _draw_row(layout: bpy.types.UILayout, name: str, first: str, second: str, icon: str) -> None:
    split = layout.split(factor=0.5)
    split.label(text=name, icon=icon, translate=False)
    row = split.row()
    row.label(text=first, translate=False)
    row.label(text=second, translate=False)


class FIPT_PT_check(Section, bpy.types.Panel):
    """Render the current view, and compare renders with photographs"""

    bl_label = "Render"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}
    presets = FIPT_PT_check_presets

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.check
        _draw_picture(layout, context, settings)
        layout.separator()
        column = layout.column(align=True)
        column.prop(settings, "which")
        column.prop(settings, "samples")
        column.operator("fipt.render_views", icon="RENDER_RESULT")
        draw_job(layout, context, "check")
        if settings.views:
            self._draw_views(context, settings)
        _draw_comparison(layout, settings)
        row = layout.row(align=True)
        row.operator("fipt.write_report", icon="FILE_TEXT")
        row.operator("fipt.open_report", text="", icon="URL")
        draw_job(layout, context, "report")
        draw_warnings(layout, context, "check", job_warnings(context, "insert", "check", "report"))

    def _draw_views(self, context: bpy.types.Context, settings: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        column = layout.column(align=True)
        _draw_row(column, iface_("PSNR in dB"), iface_("Display"), iface_("Linear"), "NONE")
        column.template_list("FIPT_UL_checked_views", "", settings, "views", settings, "active", rows=4)
        mean = (f"{settings.mean_psnr:.1f}", f"{settings.mean_psnr_linear:.1f}")
        if len(settings.views) > 1:
            _draw_row(column, iface_("Mean of {} views").format(len(settings.views)), *mean, "BLANK1")
        row = layout.row(align=True)
        row.use_property_split = False
        row.prop(settings, "picture", expand=True)
        row.operator("fipt.show_check", text="", icon="WINDOW").window = True
        if settings.picture == "ERROR":
            row = layout.row(align=True)
            row.use_property_split = False
            row.label(text="0")
            for index in range(6):
                row.prop(settings, f"color_{index}", text="")
            row.label(text="0.25")


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
        text = "The viewport previews shadows. Reflections in the room appear only in the picture."
        draw_text(layout, context, text, icon="INFO")
    _draw_settings(layout, context, settings, insert.backdrop == "PHOTOGRAPH")
    row = layout.row(align=True)
    row.scale_y = 1.3
    row.operator("fipt.final_picture", icon="RENDER_STILL")
    row.operator("fipt.open_picture", text="", icon="WINDOW")
    if insert.backdrop == "PHOTOGRAPH":
        row.operator("fipt.plate_nodes", text="", icon="NODE_COMPOSITING")
    draw_job(layout, context, "insert")
    if insert.picture:
        layout.label(text=os.path.basename(insert.picture), icon="CHECKMARK", translate=False)


def _draw_settings(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup, plate: bool
) -> None:
    """Blender's own render settings on which pictures depend most; over a plate, the size is its own."""
    from ..blend.pictures.renders import output_size, plate_size
    from ..blend.render_settings import changed_by_artist

    scene = context.scene
    plate = plate and scene.camera is not None and RESOLUTION in scene.camera
    column = layout.column(align=True)
    if not plate:
        column.prop(settings, "size")
    column.prop(scene.render, "resolution_percentage", text="Scale")
    size = plate_size(scene, scene.camera) if plate else output_size(scene)
    text = "{} x {} pixels, of the photograph" if plate else "{} x {} pixels, also with F12"
    column.label(text=iface_(text).format(*size), translate=False)
    if hasattr(scene, "cycles"):
        column = layout.column(align=True)
        column.prop(scene.cycles, "adaptive_threshold", text="Noise Threshold")
        column.prop(scene.cycles, "samples", text="Max Samples")
    if changed_by_artist(scene):
        row = layout.row()
        row.label(text="Render settings: yours", icon="USER")
        row.operator("fipt.set_rendering", text="", icon="LOOP_BACK")


def _draw_comparison(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """The buttons and the divider of the comparison."""
    column = layout.column(align=True)
    column.label(text="Wipe the Photograph Over")
    row = column.row(align=True)
    for mode, text, _, icon, _ in COMPARISONS:
        row.operator("fipt.compare", text=text, icon=icon, depress=settings.compare == mode).mode = mode
    if settings.compare != "OFF":
        row = column.row(align=True)
        row.use_property_split = False
        row.prop(settings, "divider", slider=True)
        if settings.compare != "VERSIONS":
            button = row.operator("fipt.compare", text="", icon="WINDOW")
            button.mode, button.window = settings.compare, True
