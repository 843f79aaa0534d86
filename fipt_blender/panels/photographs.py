"""The section Photographs: from the photographs of a camera to a capture."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..core.run.runfolder import RunFolder
from ..jobs import running
from ..properties.photographs import OPTIONS
from . import path
from .job import draw_error, draw_warnings
from .progress import draw_progress
from .sidebar import draw_help, draw_text, panel, rows

_KIND = "photographs"


@rows()
def FIPT_UL_photograph_groups(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The groups: whether they are used, the number of photographs, and the outcome"""
    row = layout.row(align=True)
    row.prop(item, "used", text="")
    name = row.row(align=True)
    name.active = item.used
    name.label(text=item.name, translate=False)
    count = row.row(align=True)
    count.alignment = "RIGHT"
    count.active = item.used
    count.label(text=str(len(item.photographs)), translate=False)
    if item.state == "REGISTERED":
        row.label(text="", icon="CHECKMARK")
    elif item.state == "LEFT_OUT":
        row.label(text="", icon="ERROR")


@rows()
def FIPT_UL_photographs(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The photographs of a group with their exposures"""
    split = layout.split(factor=0.45)
    split.label(text=item.name.rpartition("/")[2], translate=False)
    split.label(text=item.exposure or iface_("exposure unknown"), translate=False)


def _draw_photographs(layout: UILayout, context: Context) -> None:
    """From the photographs of a camera to a capture"""
    settings = context.scene.fipt.photographs
    column = layout.column(align=True)
    row = column.row(align=True)
    row.prop(settings, "path")
    row.operator("fipt.leave_photographs", text="", icon="X")
    column.operator("fipt.choose_photographs", text="Choose Files...", icon="FILEBROWSER")
    if settings.chosen:
        text = iface_("{} chosen files").format(len(settings.chosen.splitlines()))
        layout.label(text=text, icon="FILE_IMAGE", translate=False)
    layout.operator("fipt.find_brackets", icon="VIEWZOOM")
    if settings.groups:
        _draw_groups(layout, context, settings)
        column = layout.column()
        column.scale_y = 1.4
        if _was_stopped(settings):
            column.operator("fipt.prepare", text="Resume", icon="FILE_REFRESH")
        else:
            column.operator("fipt.prepare", icon="RENDERLAYERS")
    job = running.current()
    if job is not None and job.kind == _KIND:
        draw_progress(layout, context, job)
        draw_warnings(layout, _KIND, job.warnings)
    else:
        if settings.registered_count >= 0 and job is None:
            _draw_outcome(layout, settings)
        _draw_last_job(layout, context, settings)


def _draw_settings(layout: UILayout, context: Context) -> None:
    """How the photographs become a capture"""
    settings = context.scene.fipt.photographs
    layout.prop(settings, "output")
    column = layout.column(align=True)
    hidden = {"none": ("scale_length", "scale_picks"), "points": ()}.get(settings.scale, ("scale_picks",))
    for name in OPTIONS:
        if name not in hidden:
            column.prop(settings, name)
    if settings.scale == "points":
        column.operator("fipt.show_merged", icon="IMAGE_DATA")


def _panels(name: str, imported: bool, **options: Any) -> tuple[type[bpy.types.Panel], ...]:
    """The section and its settings, as they are before and after the import of the capture."""

    def is_shown(context: Context) -> bool:
        return path.has_photographs(context) and path.has_views(context) is imported

    section = panel("Photographs", 1, closed=imported, name=name, shown=is_shown, **options)
    settings = panel("Settings", 0, name, closed=True, name=f"{name}_settings")
    return section(_draw_photographs), settings(_draw_settings)


FIPT_PT_photographs, FIPT_PT_photographs_settings = _panels("FIPT_PT_photographs", False, after=draw_help)
FIPT_PT_photographs_done, FIPT_PT_photographs_done_settings = _panels(
    "FIPT_PT_photographs_done", True, state=path.photographs_state
)


class FIPT_PT_scale_points(bpy.types.Panel):
    """Two points of a known distance, in the merged image that is shown"""

    bl_label = "Scale of the Photographs"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "FIPT"

    @classmethod
    def poll(cls, context: Context) -> bool:
        from ..blend.capture.scale_picks import shown_group

        return bool(shown_group(context.space_data, context.scene.fipt.photographs))

    def draw(self, context: Context) -> None:
        layout = self.layout
        settings = context.scene.fipt.photographs
        layout.operator("fipt.pick_scale_points", icon="EYEDROPPER")
        row = layout.row()
        row.enabled = bool(settings.scale_picks)
        row.operator("fipt.pick_scale_points", text="Add This View", icon="ADD").extend = True
        layout.prop(settings, "scale_length")


def _draw_groups(layout: UILayout, context: Context, settings: PropertyGroup) -> None:
    """The groups, and the photographs of the active one."""
    layout = layout.column()
    layout.use_property_split = False
    row = layout.row()
    row.template_list("FIPT_UL_photograph_groups", "", settings, "groups", settings, "active_group", rows=5)
    column = row.column(align=True)
    column.operator("fipt.merge_brackets", text="", icon="FULLSCREEN_EXIT")
    column.operator("fipt.split_bracket", text="", icon="FULLSCREEN_ENTER")
    text = iface_("{} groups become views").format(settings.used_count)
    layout.label(text=text, icon="IMAGE_DATA", translate=False)
    if not 0 <= settings.active_group < len(settings.groups):
        return
    group = settings.groups[settings.active_group]
    count = min(len(group.photographs), 7)
    layout.template_list(
        "FIPT_UL_photographs", "", group, "photographs", settings, "active_photograph", rows=count
    )
    if group.problem:
        draw_text(layout, f"{group.name}: {group.problem}", icon="ERROR")
    if group.clipped_share > 0.0:
        text = iface_("{}: {:.2f}% of the pixels are clipped in every photograph")
        draw_text(layout, text.format(group.name, 100.0 * group.clipped_share), icon="INFO")


def _draw_last_job(layout: UILayout, context: Context, settings: PropertyGroup) -> None:
    """The error and the warnings of the last job on these photographs."""
    job = running.last(_KIND)
    if job is None or job.run_folder != settings.capture_folder():
        return
    if job.error is not None:
        draw_error(layout, job.error, RunFolder(job.run_folder))
        if settings.groups:
            layout.operator("fipt.open_photographs_report", icon="URL")
    draw_warnings(layout, _KIND, job.warnings)


def _was_stopped(settings: PropertyGroup) -> bool:
    """Whether the last job on these photographs was cancelled, so that the next one continues it."""
    job = running.last(_KIND)
    return job is not None and job.state == "cancelled" and job.run_folder == settings.capture_folder()


def _draw_outcome(layout: UILayout, settings: PropertyGroup) -> None:
    """How many views have a camera, and the way on."""
    all_found = settings.registered_count == settings.used_count
    text = iface_("{} of {} views have a camera").format(settings.registered_count, settings.used_count)
    layout.label(text=text, icon="CHECKMARK" if all_found else "ERROR", translate=False)
    row = layout.row(align=True)
    button = row.operator("fipt.import_capture", icon="IMPORT")
    button.filepath = str(settings.capture_folder() or "")
    row.operator("fipt.open_photographs_report", text="", icon="URL")
