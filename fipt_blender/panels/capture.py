"""The section Capture: cameras, photographs and the room's mesh."""

from __future__ import annotations

import sys
from collections.abc import Callable

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.marks import ADDED
from ..jobs import running
from ..properties.capture import IMPORT_OPTIONS
from . import path, swatches
from .job import draw_error, draw_job, draw_warnings, job_warnings
from .presets import draw_import_presets
from .sidebar import draw_help, draw_text, panel, rows

_BASIC_OPTIONS = ("mesh", "up_axis", "scale", "triangles")  # that are not under Advanced


@rows()
def FIPT_UL_views(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The views: whether and for what they are used, and the outcome of their check"""
    row = layout.row(align=True)
    row.prop(item, "enabled", text="")
    name = row.row(align=True)
    name.active = item.enabled
    name.label(text=shown_name(item.name, context.scene.fipt.capture.name_prefix), translate=False)
    if item.camera not in bpy.data.objects:
        row.label(text="", icon="CANCEL")
    elif item.warning:
        row.label(text="", icon="ERROR")
    elif item.checked:
        row.label(text="", icon="CHECKMARK")
    row.prop(item, "split", text="", icon_only=True, emboss=False)


def shown_name(name: str, prefix: str) -> str:
    """A view's name without the folder where all are in one: the end of long names is cut off in lists.

    Args:
        prefix: what the names of all views start with.
    """
    folder = name.rpartition("/")[0] + "/"
    return name.removeprefix(folder) if prefix.startswith(folder) else name


@panel("Capture", 2, closed=True, shown=path.has_views, state=path.capture_state, after=draw_help)
def FIPT_PT_capture(layout: UILayout, context: Context) -> None:
    """Cameras, photographs and the room's mesh"""
    settings = context.scene.fipt.capture
    column = layout.column(align=True)
    column.prop(settings, "path", text="Folder")
    column.operator("fipt.import_capture", text="Import Again", icon="FILE_REFRESH")
    if settings.imported_up:
        _draw_up(layout, settings)
    draw_import(layout, context)
    draw_warnings(layout, "capture", job_warnings(context, "capture"))


def _draw_up(layout: UILayout, settings: PropertyGroup) -> None:
    """Which axis of the capture points up, and what told the import."""
    layout.prop(settings, "up")
    texts = {
        "option": "{axis} is up by the import settings",
        "format": "{axis} is up by the format",
        "planes": "{angle:.1f}\u00b0 from {axis} is up by the planes of the room",
        "cameras": "{angle:.1f}\u00b0 from {axis} is up by the cameras",
    }
    if settings.up_source in texts:  # of a .blend of another version it may be something else
        text = iface_(texts[settings.up_source])
        text = text.format(axis=settings.imported_up.upper(), angle=settings.up_angle)
        draw_text(layout, text, icon="INFO")


def import_settings(order: int, parent: str, shown: Callable[[Context], object]) -> type[bpy.types.Panel]:
    """The panel of the options for reading a capture, which two sections have."""
    name, after = f"{parent}_import", draw_import_presets
    made = panel("Import Settings", order, parent, closed=True, name=name, shown=shown, after=after)
    return made(_draw_import_settings)


def _draw_import_settings(layout: UILayout, context: Context) -> None:
    """Options for reading the capture"""
    settings = context.scene.fipt.capture
    column = layout.column(align=True)
    for name in _BASIC_OPTIONS:
        column.prop(settings, name)
    if settings.views:
        layout.operator("fipt.simplify_room", icon="MOD_DECIM")
    header, body = layout.panel("fipt_import_advanced", default_closed=True)
    header.label(text="Advanced")
    if body is None:
        return
    column = body.column(align=True)
    for name in IMPORT_OPTIONS:
        if name not in _BASIC_OPTIONS and (settings.panorama or not name.startswith("panorama_")):
            column.prop(settings, name)
    if settings.panorama:
        body.operator("fipt.place_panorama", icon="PIVOT_CURSOR")
    if settings.views:
        body.operator("fipt.use_scene_cameras", icon="CAMERA_DATA")


FIPT_PT_capture_import = import_settings(3, "FIPT_PT_capture", path.has_views)


@panel("Room", 1, parent="FIPT_PT_capture", closed=True)
def FIPT_PT_capture_room(layout: UILayout, context: Context) -> None:
    """The meshes that form the room"""
    settings = context.scene.fipt.capture
    layout.prop(settings, "room", text="Collection", placeholder="Parts")
    row = layout.row(align=True)
    row.operator("fipt.set_room", text="From Selection", icon="RESTRICT_SELECT_OFF")
    row.operator("fipt.import_mesh", text="Import Mesh", icon="MESH_DATA")
    if settings.views and not settings.room_objects(context.scene):
        text = "The room has no mesh. Import one, or select the objects that form the room."
        draw_text(layout, iface_(text), icon="ERROR")
    elif settings.views:
        _draw_additions(layout, context, settings)


def _draw_additions(layout: UILayout, context: Context, settings: PropertyGroup) -> None:
    """What was added to a scan, and the buttons that add more."""
    count = sum(ADDED in item for item in settings.room_objects(context.scene))
    if settings.unseen_share < 0.0 and not count:
        text = "Estimate looks by itself for what a scan lacks. To decide before it, start with Check Views."
        draw_text(layout, iface_(text), icon="INFO")
    column = layout.column(align=True)
    column.operator("fipt.find_missing_surfaces", icon="VIEWZOOM")
    column.operator_menu_enum("fipt.add_surface", "shape", icon="ADD")
    draw_job(layout, context, "completion")
    draw_warnings(layout, "completion", job_warnings(context, "completion"))
    if count:
        row = layout.row(align=True)
        row.label(text=iface_("{} added").format(count), icon="INFO", translate=False)
        row.operator("fipt.select_added", text="Select", icon="RESTRICT_SELECT_OFF")
    if count or settings.completed:
        layout.prop(settings, "completed")


@panel("Views", 0, parent="FIPT_PT_capture", shown=path.has_views)
def FIPT_PT_capture_views(layout: UILayout, context: Context) -> None:
    """The photographs with their cameras, and how each is used"""
    layout.use_property_split = False
    settings = context.scene.fipt.capture
    draw_thumbnail(layout, settings)
    row = layout.row()
    row.template_list("FIPT_UL_views", "", settings, "views", settings, "active_view", rows=6)
    column = row.column(align=True)
    column.operator("fipt.look_through", text="", icon="OUTLINER_OB_CAMERA")
    column.separator()
    column.operator("fipt.look_through", text="", icon="TRIA_UP").step = -1
    column.operator("fipt.look_through", text="", icon="TRIA_DOWN").step = 1
    column.separator()
    column.operator_menu_enum("fipt.tick_views", "action", text="", icon="DOWNARROW_HLT")
    draw_photograph(layout, settings)
    _draw_active(layout, settings)
    counts = iface_("{} for estimation, {} held back").format(settings.train_count, settings.held_back_count)
    layout.label(text=counts, icon="IMAGE_DATA", translate=False)
    layout.operator("fipt.check_views", icon="VIEWZOOM")
    draw_job(layout, context, "survey")
    if settings.unseen_share >= 0.0:
        _draw_survey(layout, context, settings)
    draw_warnings(layout, "survey", job_warnings(context, "survey"))


def draw_thumbnail(layout: UILayout, settings: PropertyGroup) -> None:
    """The photograph of the active view, which opens those of all views when it is clicked."""
    layout.template_icon_view(settings, "picture", show_labels=True, scale=5.0, scale_popup=5.0)


def draw_photograph(layout: UILayout, settings: PropertyGroup) -> None:
    """Whether and how strongly the photograph lies over the room."""
    row = layout.row(align=True)
    switch = settings.photograph_switch()
    shown = getattr(settings, switch)
    row.prop(settings, switch, text="", icon="HIDE_OFF" if shown else "HIDE_ON")
    slider = row.row(align=True)
    slider.active = shown
    slider.prop(settings, "photograph_opacity", slider=True)


def _draw_active(layout: UILayout, settings: PropertyGroup) -> None:
    """The result of the check for the active view."""
    if not 0 <= settings.active_view < len(settings.views):
        return
    view = settings.views[settings.active_view]
    name = shown_name(view.name, settings.name_prefix)
    if view.camera not in bpy.data.objects:
        text = iface_("The camera of this view was deleted, so the view is not used.")
        draw_text(layout, text, icon="CANCEL")
    elif view.warning:
        draw_text(layout, f"{name}: {view.warning}", icon="ERROR")
    elif view.checked:
        text = iface_("{}: {:.0f}% of the pixels show the room, {:.1f}% look overexposed")
        text = text.format(name, 100.0 * view.room_share, 100.0 * view.clipped_share)
        if view.misfit >= 0.0:
            text += iface_(", the mesh is {:.1f} pixels off").format(view.misfit)
        draw_text(layout, text, icon="CHECKMARK")


def _draw_survey(layout: UILayout, context: Context, settings: PropertyGroup) -> None:
    """The result of the check for all views together."""
    if settings.warning_count:
        text = iface_("{} ticked views have warnings").format(settings.warning_count)
        layout.label(text=text, icon="ERROR", translate=False)
    if settings.misfit >= 0.0:
        text = iface_("The mesh is {:.1f} pixels off in the median view").format(settings.misfit)
        draw_text(layout, text, icon="INFO")
    shown = shown_colors(context.scene)
    text = iface_("{:.0f}% of the room's surface is not seen by any ticked view").format(
        100.0 * settings.unseen_share
    )
    draw_text(layout, text, icon="INFO")
    hides = shown == "coverage"
    text = "Hide Coverage" if hides else "Show Coverage"
    layout.operator("fipt.show_coverage", text=text, icon="OVERLAY", depress=hides).show = not hides
    if hides:
        draw_legend(layout)


def draw_legend(layout: UILayout) -> None:
    """The colours of the coverage; to be drawn where they are shown, so that their module is loaded."""
    from ..blend.capture.survey import COVERAGE

    column = layout.column(align=True)
    column.label(text="Number of Views")
    row = column.row(align=True)
    for level in COVERAGE:
        row.label(text=level.label, icon_value=swatches.icon(level.color), translate=False)


def draw_import(layout: UILayout, context: Context) -> None:
    """Progress of the import, or why the last one failed; a failed import no longer has a run folder."""
    draw_job(layout, context, "capture")
    job = running.last("capture")
    if running.current() is not None or job is None or job.error is None:
        return
    if job.scene_name == context.scene.name and not running.belongs_to(job, context.scene):
        draw_error(layout, job.error, None)


def shown_colors(scene: bpy.types.Scene) -> str:
    """The kind of what is drawn over the room, see `overlay.show`, or "". Does not import that module."""
    overlay = sys.modules.get(__package__.rpartition(".")[0] + ".blend.capture.overlay")
    return overlay.shown(scene) if overlay is not None else ""
