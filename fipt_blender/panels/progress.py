"""How the progress of a job is drawn, in panels and in the status bar, and durations are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, UILayout

from ..jobs import running
from ..jobs.job_scene import uses_run_folder
from .sidebar import draw_text

if TYPE_CHECKING:
    from ..bridge.job import Job


_FORECASTS = (1, 2, 5, 10, 20, 40, 60)  # ends of ranges, minutes


def draw_progress(layout: UILayout, context: Context, job: Job) -> None:
    """A progress bar with a cancel button, the stage, the remaining time and the largest memory."""
    column = layout.column(align=True)
    row = column.row(align=True)  # above all text that may wrap, so that the button stays under the pointer
    # Named, since Apply Results follows Estimate in the same place and starts at 0.
    text = iface_("{}: {:.0f}%").format(iface_(job.title), 100.0 * job.fraction)
    row.progress(factor=job.fraction, text=text)
    row.operator("fipt.cancel", text="", icon="X")
    draw_text(column, iface_("Stopping...") if job.stopping else iface_(job.stage_text))
    if job.scene_name and not uses_run_folder(context.scene, job.run_folder):
        name = running.other_file() or job.scene_name
        text = iface_("Running for '{}', in {}").format(name, job.run_folder.name)
        draw_text(column, text, icon="SCENE_DATA")
    facts = []
    if job.remaining_seconds is not None and job.fraction > 0.0:
        facts.append(left_text(job.remaining_seconds))
    facts.append(iface_("{} so far").format(time_text(job.worked_seconds)))
    if job.memory_gb:
        facts.append(iface_("{:.1f} GB of memory").format(job.memory_gb))
    column.label(text="   ".join(facts), translate=False)


def time_text(seconds: float) -> str:
    """A duration in one or two units: "45 s", "4 min", "1 h 5 min"."""
    rounded = round(seconds)
    if rounded < 60:
        return iface_("{} s").format(rounded)
    if rounded < 3600:
        return iface_("{} min").format(round(rounded / 60))
    return iface_("{} h {} min").format(rounded // 3600, rounded % 3600 // 60)


def left_text(seconds: float) -> str:
    """A forecast as a range, since other programs may slow the job down: "2 to 5 min left"."""
    minutes = seconds / 60.0
    if minutes < 1.0:
        return iface_("less than 1 min left")
    if minutes >= 60.0:
        return iface_("{} to {} h left").format(int(minutes / 60.0), int(minutes / 60.0) + 1)
    high = next(mark for mark in _FORECASTS if mark > minutes)
    return iface_("{} to {} min left").format(_FORECASTS[_FORECASTS.index(high) - 1], high)


def register() -> None:
    """Add the job to the status bar."""
    bpy.types.STATUSBAR_HT_header.append(_draw)


def unregister() -> None:
    """Remove the job from the status bar."""
    bpy.types.STATUSBAR_HT_header.remove(_draw)


def status_text(job: Job) -> str:
    """The job in a few words, e.g. "Estimate: 42%, 2 to 5 min left"."""
    title = iface_(job.title)
    if job.stopping:
        return iface_("{}: stopping...").format(title)
    text = iface_("{}: {:.0f}%").format(title, 100.0 * job.fraction)
    if job.remaining_seconds is None or job.fraction == 0.0:
        return text
    return f"{text}, {left_text(job.remaining_seconds)}"


def _draw(header: bpy.types.Header, context: Context) -> None:
    job = running.current()
    if job is None:
        return
    row = header.layout.row(align=True)
    row.separator(factor=2.0)
    bar = row.row()
    bar.ui_units_x = 11.0
    bar.progress(factor=job.fraction, text=status_text(job))
    row.operator("fipt.cancel", text="", icon="X", emboss=False)
