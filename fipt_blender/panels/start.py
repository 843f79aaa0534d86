"""The section Start: the engine, then the example or a folder of the artist's own."""

from __future__ import annotations

import time

from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, UILayout

from .. import machine
from ..jobs import running, runstate
from . import engine, path
from .capture import draw_import, import_settings
from .job import draw_job, draw_warnings, job_warnings
from .progress import time_text
from .sidebar import draw_help, draw_text, panel


@panel("Start", 0, shown=path.needs_start, after=draw_help)
def FIPT_PT_start(layout: UILayout, context: Context) -> None:
    """The first steps: set up the engine, then try the example or choose a folder"""
    job = running.current()
    if not machine.has_engine() or (job is not None and job.kind == running.DATA_KIND):
        engine.draw_set_up(layout)
        return
    if draw_job(layout, context, "estimate"):  # the example, before its views are there
        return
    settings = context.scene.fipt.capture
    for run in runstate.unsaved_runs():
        stages = iface_("finished") if run.finished else iface_("{} stages").format(run.stages)
        text = iface_("{}, {} old, {}: Open").format(run.name, time_text(time.time() - run.time), stages)
        layout.operator("fipt.open_run", text=text, icon="RECOVER_LAST", translate=False).folder = str(
            run.folder
        )
    column = layout.column()
    column.scale_y = 1.4
    column.operator("fipt.try_example", icon="HOME")
    draw_text(
        layout, iface_("Or choose a folder: photographs, a capture with cameras, or the data of a scan.")
    )
    column = layout.column(align=True)
    column.prop(settings, "path", text="Folder")
    if settings.path:
        column.operator("fipt.import_capture", icon="IMPORT")
    else:
        column.operator("fipt.choose_capture", text="Choose Folder...", icon="FILEBROWSER")
    if any(item.type == "CAMERA" and item.data.background_images for item in context.scene.objects):
        layout.operator("fipt.use_scene_cameras", icon="CAMERA_DATA")
    draw_import(layout, context)
    draw_warnings(layout, "capture", job_warnings(context, "capture"))


def _can_import(context: Context) -> bool:
    return machine.has_engine() and not path.has_views(context)


FIPT_PT_start_import = import_settings(0, "FIPT_PT_start", _can_import)
