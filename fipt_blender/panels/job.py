# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How a section shows its job: progress while it runs; afterwards what went wrong, with what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import running
from ..core.job.runfolder import RunFolder
from .sidebar import draw_text

if TYPE_CHECKING:
    from ..bridge.process import Message


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, kind: str) -> bool:
    """Draw the running job of a kind, or how the last one ended; returns whether one runs."""
    job = running.current()
    if job is not None and job.kind == kind:
        draw_progress(layout, context, job)
        draw_messages(layout, context, job.warnings)
        return True
    ended = running.last(kind)
    if ended is not None and running.concerns(context.scene, ended):
        if ended.error is not None:
            run = RunFolder(ended.run_folder) if context.scene.fipt.run_folder else None
            draw_error(layout, context, ended.error, run)
        draw_messages(layout, context, ended.warnings)
    return False


def draw_progress(layout: bpy.types.UILayout, context: bpy.types.Context, job: running.RunningJob) -> None:
    """The bar with the stage, the share that is done, the time that is left and the memory; Cancel."""
    column = layout.column(align=True)
    if job.scene_name and not running.names_folder(context.scene, job.run_folder):
        text = iface_("For another scene, '{}', in {}").format(job.scene_name, job.run_folder.name)
        draw_text(column, context, text, icon="SCENE_DATA")
    draw_text(column, context, iface_("Stopping ...") if job.stopping else iface_(job.stage_text))
    row = column.row(align=True)
    row.progress(factor=job.fraction, text=f"{100.0 * job.fraction:.0f} %")
    row.operator("fipt.cancel", text="", icon="X")
    facts = []
    if job.remaining_seconds is not None and job.fraction > 0.0:
        facts.append(iface_("{} left").format(time_text(job.remaining_seconds)))
    if job.memory_gb:
        facts.append(iface_("{:.1f} GB memory").format(job.memory_gb))
    column.label(text="   ".join(facts), translate=False)


def draw_error(
    layout: bpy.types.UILayout, context: bpy.types.Context, error: Message, run: RunFolder | None
) -> None:
    """An error with its remedy, and a button that mends it where there is one.

    Args:
        run: whose log tells more, if there is one.
    """
    box = layout.box()
    draw_text(box, context, error["text"], icon="ERROR", alert=True)
    draw_text(box, context, error["remedy"], icon="INFO")
    column = box.column(align=True)
    if error["code"] in ("engine-missing", "package-missing"):
        show = column.operator("preferences.addon_show", text="Open Preferences", icon="PREFERENCES")
        show.module = __package__.rpartition(".")[0]
    elif error["code"] == "out-of-memory":
        column.operator("fipt.smaller_preset", icon="TRIA_DOWN")
    if run is not None:
        column.operator("wm.path_open", text="Show Log", icon="TEXT").filepath = str(run.log)


def draw_messages(
    layout: bpy.types.UILayout, context: bpy.types.Context, messages: Iterable[Message]
) -> None:
    """Warnings with their remedies."""
    for message in messages:
        column = layout.column(align=True)
        draw_text(column, context, message["text"], icon="ERROR")
        draw_text(column, context, message["remedy"], icon="BLANK1")


def time_text(seconds: float) -> str:
    """A time for people: "45 s", "4 min", "1 h 5 min"."""
    whole = round(seconds)
    if whole < 60:
        return iface_("{} s").format(whole)
    if whole < 3600:
        return iface_("{} min").format(round(whole / 60))
    return iface_("{} h {} min").format(whole // 3600, whole % 3600 // 60)
