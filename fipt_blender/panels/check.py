"""The section Render: pictures of the room, the report."""

from __future__ import annotations

import os

from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, UILayout

from ..blend.marks import RESOLUTION
from . import path
from .capture import draw_photograph
from .job import draw_job, draw_warnings, job_warnings
from .sidebar import draw_text, panel


@panel("Render", 6, shown=path.has_results)
def FIPT_PT_check(layout: UILayout, context: Context) -> None:
    """Render pictures of the room"""
    from ..blend.render_settings import can_denoise

    insert = context.scene.fipt.insert
    row = layout.row()
    row.scale_y = 1.3
    text = "Picture over Photograph" if insert.backdrop == "PHOTOGRAPH" else "Final Picture"
    row.operator("fipt.final_picture", text=text, icon="RENDER_STILL")
    if insert.picture:
        layout.label(text=os.path.basename(insert.picture), icon="CHECKMARK", translate=False)
    if not can_denoise():
        text = "This Blender has no denoiser, so pictures are noisy. Blender from blender.org has one."
        draw_text(layout, iface_(text), icon="INFO")
    draw_warnings(layout, "check", job_warnings(context, "report"))


@panel("Picture", 0, parent="FIPT_PT_check", closed=True)
def FIPT_PT_check_picture(layout: UILayout, context: Context) -> None:
    """What the picture shows, and its size: of the rendered room, or over the photograph"""
    insert = context.scene.fipt.insert
    plate = insert.backdrop == "PHOTOGRAPH"
    row = layout.row(align=True)
    for mode, text, icon in (("ROOM", "Rendered Room", "HOME"), ("PHOTOGRAPH", "Photograph", "IMAGE_DATA")):
        row.operator("fipt.set_backdrop", text=text, icon=icon, depress=insert.backdrop == mode).mode = mode
    row = layout.row(align=True)
    row.operator("fipt.add_ball", text="Gray Ball", icon="SPHERE").kind = "GRAY_BALL"
    row.operator("fipt.add_ball", text="Mirror Ball", icon="SHADING_RENDERED").kind = "MIRROR_BALL"
    _draw_settings(layout, context, plate)
    if plate:
        text = "The picture has the lights as they were photographed, and those that you added."
        draw_text(layout, text, icon="INFO")
        layout.operator("fipt.plate_nodes", icon="NODE_COMPOSITING")
    else:
        draw_photograph(layout, context.scene.fipt.capture)
    layout.operator("fipt.open_picture", icon="WINDOW")


@panel("Report", 1, parent="FIPT_PT_check", closed=True)
def FIPT_PT_check_report(layout: UILayout, context: Context) -> None:
    """A page with the results, pictures and how good they are"""
    row = layout.row(align=True)
    row.operator("fipt.write_report", icon="FILE_TEXT")
    row.operator("fipt.open_report", text="", icon="URL")
    draw_job(layout, context, "report")


def _draw_settings(layout: UILayout, context: Context, plate: bool) -> None:
    """Blender's own render settings on which pictures depend most; a plate keeps its proportions."""
    from ..blend.pictures.renders import output_size, plate_size
    from ..blend.render_settings import changed_by_artist

    scene = context.scene
    plate = plate and scene.camera is not None and RESOLUTION in scene.camera
    column = layout.column(align=True)
    column.prop(scene.fipt.check, "size")
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
