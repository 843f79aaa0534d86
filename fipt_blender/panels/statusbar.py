# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The running job in Blender's status bar, which is visible whatever tab or workspace is open."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..jobs import running
from .progress import time_text


def register() -> None:
    """Add the job to the status bar."""
    bpy.types.STATUSBAR_HT_header.append(_draw)


def unregister() -> None:
    """Remove the job from the status bar."""
    bpy.types.STATUSBAR_HT_header.remove(_draw)


def status_text(job: running.RunningJob) -> str:
    """The job in a few words, e.g. "Estimate: 42%, 3 min left"."""
    title = iface_(job.title)
    if job.stopping:
        return iface_("{}: stopping...").format(title)
    text = iface_("{}: {:.0f}%").format(title, 100.0 * job.fraction)
    if job.remaining_seconds is None or job.fraction == 0.0:
        return text
    return iface_("{}, {} left").format(text, time_text(job.remaining_seconds))


def _draw(header: bpy.types.Header, context: bpy.types.Context) -> None:
    job = running.current()
    if job is None:
        return
    row = header.layout.row(align=True)
    row.separator(factor=2.0)
    bar = row.row()
    bar.ui_units_x = 11.0
    bar.progress(factor=job.fraction, text=status_text(job))
    row.operator("fipt.cancel", text="", icon="X", emboss=False)
