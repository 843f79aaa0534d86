# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: the engine's set-up, its check and its log."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import preferences, running
from ..core.job.errors import FiptError
from .job_operator import DATA_KIND, DataJobOperator

if TYPE_CHECKING:
    from ..bridge.sequence import Job

_LOG_LINES = 30


class FIPT_OT_set_up_engine(DataJobOperator, bpy.types.Operator):
    """Make the engine's own Python environment and install its packages there. Blender's own Python stays
    as it is. Cancelled, it continues with what was downloaded"""

    bl_idname = "fipt.set_up_engine"
    bl_label = "Set Up Engine"
    title = "Set Up Engine"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        values = preferences.get_preferences()
        if values.engine_python:
            cls.poll_message_set("An interpreter of your own is named; empty that field to set one up here")
            return False
        if not values.wheel_folder and not bpy.app.online_access:
            cls.poll_message_set(
                "Blender may not go online: allow it in Preferences > System > Network, or name a folder of"
                " wheels to install from"
            )
            return False
        return True

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        from ..datajob import EngineStatus, data_job, set_up_step

        values, data = preferences.get_preferences(), preferences.data_folder()
        wheels = Path(bpy.path.abspath(values.wheel_folder)) if values.wheel_folder else None
        if wheels is not None and not wheels.is_dir():
            raise FiptError(
                "wheels-missing", f"The folder of wheels {wheels} does not exist.", "Choose another folder."
            )
        status = EngineStatus()
        step = set_up_step(Path(sys.executable), data, values.device, wheels)
        return data_job([step, status.check_step()]), status.store


class FIPT_OT_check_engine(DataJobOperator, bpy.types.Operator):
    """Try the engine on this machine and say what is missing and how to mend it"""

    bl_idname = "fipt.check_engine"
    bl_label = "Check"
    title = "Check Engine"

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        from ..datajob import EngineStatus, data_job

        status = EngineStatus()
        return data_job([status.check_step()]), status.store


class FIPT_OT_cancel_set_up(bpy.types.Operator):
    """Stop; what was downloaded is kept for the next time"""

    bl_idname = "fipt.cancel_set_up"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        busy = running.current()
        if busy is None or busy.kind != DATA_KIND:
            cls.poll_message_set("No set-up is running")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        running.cancel()
        return {"FINISHED"}


class FIPT_OT_show_log(bpy.types.Operator):
    """Show the end of the log of set-up and check"""

    bl_idname = "fipt.show_log"
    bl_label = "Set-Up Log"

    _lines: list[str]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        known = preferences.get_preferences().status or running.current() or running.last(DATA_KIND)
        if not known:
            cls.poll_message_set("Nothing was set up or checked yet")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self._lines = read_log()
        return context.window_manager.invoke_popup(self, width=800)

    def execute(self, context: bpy.types.Context) -> set[str]:
        print("\n".join(read_log()))
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        from ..datajob import log_file

        layout = self.layout
        row = layout.row()
        row.label(text=str(log_file()), translate=False, icon="TEXT")
        row.operator("wm.path_open", text="Open Whole Log").filepath = str(log_file())
        column = layout.box().column(align=True)
        column.scale_y = 0.7
        for line in self._lines:
            column.label(text=line[:150], translate=False)


def read_log() -> list[str]:
    """The last lines of the log."""
    from collections import deque

    from ..datajob import log_file

    try:
        with open(log_file(), encoding="utf-8", errors="replace") as file:
            return [line.rstrip() for line in deque(file, _LOG_LINES)]
    except OSError as error:
        return [f"{log_file()}: {error.strerror}"]


class FIPT_OT_copy_wheel_command(bpy.types.Operator):
    """Copy the command that downloads all packages into a folder, to be run on a machine with network that
    has the same system; name that folder here afterwards"""

    bl_idname = "fipt.copy_wheel_command"
    bl_label = "Copy Download Command"

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..bridge.pins import read_pins, wheel_command

        try:
            command = wheel_command(read_pins(), sys.version_info[:2])
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.window_manager.clipboard = command
        self.report({"INFO"}, iface_("Copied: {}").format(command))
        return {"FINISHED"}


CLASSES = (
    FIPT_OT_set_up_engine,
    FIPT_OT_check_engine,
    FIPT_OT_cancel_set_up,
    FIPT_OT_show_log,
    FIPT_OT_copy_wheel_command,
)
