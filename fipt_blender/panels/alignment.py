"""The panel Alignment of the section Capture: capture and scene, cameras and mesh."""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from .job import draw_job, draw_warnings, job_warnings
from .sidebar import draw_text, panel, rows


@rows()
def FIPT_UL_pairs(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The pairs of points, each with its error"""
    row = layout.row(align=True)
    views = ", ".join(sight.name for sight in item.sights)
    row.label(text=f"{index + 1}: {views}", translate=False)
    missing = item.name not in context.scene.objects
    text = f"{1000.0 * item.error:.3g} mm" if item.error >= 0.0 else ""
    row.label(text=text, icon="CANCEL" if missing else "NONE", translate=False)
    row.operator("fipt.remove_pair", text="", icon="X", emboss=False).index = index


@panel(
    "Alignment",
    2,
    parent="FIPT_PT_capture",
    closed=True,
    shown=lambda context: context.scene.fipt.capture.alignment is not None,
)
def FIPT_PT_capture_alignment(layout: UILayout, context: Context) -> None:
    """Move the cameras and the imported mesh together, or the cameras to the mesh"""
    settings = context.scene.fipt.capture
    column = layout.column(align=True)
    column.prop(settings.alignment, "location", text="Location")
    column = layout.column(align=True)
    column.prop(settings.alignment, "rotation_euler", text="Rotation")
    layout.prop(settings, "alignment_scale")


@panel("Cameras to Mesh", 0, parent="FIPT_PT_capture_alignment", closed=True)
def FIPT_PT_capture_pairs(layout: UILayout, context: Context) -> None:
    """Move the cameras to a mesh from another program, by points that you pick"""
    layout.use_property_split = False
    settings = context.scene.fipt.alignment
    _draw_pairs(layout, settings)
    layout.operator("fipt.refine_alignment", icon="POINTCLOUD_DATA")
    draw_job(layout, context, "align")
    if settings.summary:
        draw_text(layout, iface_(settings.summary), icon="INFO")
    draw_warnings(layout, "align", job_warnings(context, "align"))


def _draw_pairs(layout: UILayout, settings: PropertyGroup) -> None:
    """Picking, the list of pairs, and aligning by them."""
    layout.operator("fipt.pick_pair", icon="EYEDROPPER")
    if not settings.pairs:
        draw_text(layout, "Pick three or more points of the mesh, each in two photographs.", icon="INFO")
        return
    layout.template_list("FIPT_UL_pairs", "", settings, "pairs", settings, "active_pair", rows=4)
    if settings.error >= 0.0:
        text = iface_("The pairs are off by {:.3g} mm").format(1000.0 * settings.error)
        layout.label(text=text, icon="CHECKMARK", translate=False)
    if settings.problem:
        draw_text(layout, settings.problem, icon="ERROR")
    row = layout.row(align=True)
    row.operator("fipt.align_by_pairs", icon="CON_CAMERASOLVER")
    row.prop(settings, "show_marks", text="", icon="HIDE_OFF")
