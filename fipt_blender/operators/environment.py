# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: set up the engine, check it, show its log."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..core.run.errors import FiptError
from ..jobs import running
from ..jobs.tasks import Task
from .action import REGISTER, action, reported
from .polls import all_of, needs, no_job

if TYPE_CHECKING:
    from ..bridge.step import Step


class FIPT_OT_set_up_engine(bpy.types.Operator):
    bl_idname = "fipt.set_up_engine"
    bl_label = "Set Up Engine"
    bl_description = (
        "Create a Python environment for the engine and install its packages there. Blender's own"
        " Python is not changed. If you cancel, the finished downloads are kept"
    )
    bl_options = {"REGISTER"}

    allow_large: bpy.props.BoolProperty(
        name="Allow Large Download",
        description="Download PyTorch's build with CUDA if the one for the CPU can't be reached",
        options={"SKIP_SAVE"},
    )
    # In a window, which must not wait: by the dialog, or by a button beside which the size is written.
    confirmed: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """State the size of the download before anything is downloaded, unless the button has done so."""
        from ..jobs import setup_size

        if bpy.app.background or machine.get_preferences().wheel_folder:
            return self._start(context, wait=bpy.app.background)
        self.allow_large = self.allow_large or setup_size.was_too_large()
        if self.confirmed:
            return self.execute(context)
        self.confirmed, size = True, setup_size.size()
        message = iface_("Downloads about {:.1f} GB and needs {:.1f} GB on the disk").format(
            size.download_gb, size.disk_gb
        )
        if failure := setup_size.likely_failure():
            message = f"{failure} {message}"
        return context.window_manager.invoke_confirm(
            self, event, title=iface_(self.bl_label), message=message, confirm_text=iface_("Set Up")
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._start(context, wait=not self.confirmed)

    def _start(self, context: bpy.types.Context, wait: bool) -> set[str]:
        return reported(self, context, wait, lambda: set_up_task(self.allow_large))

    poll = all_of(
        no_job,
        needs(
            lambda _: not machine.get_preferences().engine_python,
            "Clear Own Interpreter first; set-up is not needed while that is used",
        ),
        needs(
            lambda _: machine.get_preferences().wheel_folder or bpy.app.online_access,
            "Enable Allow Online Access in Preferences > System > Network, or select a Folder of Wheels",
        ),
    )


def set_up_task(allow_large: bool) -> Task:
    """Create the engine's environment, and check it."""
    from ..jobs.data_job import EngineStatus, data_task, set_up_step

    status = EngineStatus(set_up=True)

    def steps() -> list[Step]:
        values, data = machine.get_preferences(), machine.data_folder()
        wheels = Path(bpy.path.abspath(values.wheel_folder)) if values.wheel_folder else None
        if wheels is not None and not wheels.is_dir():
            raise FiptError(
                "wheels-missing",
                f"The folder {wheels} does not exist.",
                "Select another folder as Folder of Wheels.",
            )
        step = set_up_step(Path(sys.executable), data, values.device, wheels, allow_large)
        return [step, status.check_step()]

    return data_task("Set Up Engine", steps, status.store)


@action("Check", needs=(no_job,), options=REGISTER)
def check_engine(scene: bpy.types.Scene) -> Task:
    """Test the engine on this machine, and show what is missing and how to fix it."""
    from ..jobs.data_job import EngineStatus, data_task

    status = EngineStatus()
    return data_task("Check Engine", lambda: [status.check_step()], status.store)


def _set_up_runs(context: bpy.types.Context) -> bool:
    job = running.current()
    return job is not None and job.kind == running.DATA_KIND


@action("Cancel", needs=(needs(_set_up_runs, "No set-up is running"),), options=REGISTER)
def cancel_set_up(scene: bpy.types.Scene) -> None:
    """Cancel the set-up. Finished downloads are kept for the next time."""
    running.cancel()


class FIPT_OT_show_log(bpy.types.Operator):
    """Show the last lines of the log of Set Up Engine and Check"""

    bl_idname = "fipt.show_log"
    bl_label = "Set-Up Log"

    _lines: list[str]

    poll = all_of(
        needs(
            lambda context: (
                machine.get_preferences().status or running.current() or running.last(running.DATA_KIND)
            ),
            "Use Set Up Engine or Check first",
        )
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self._lines = read_log()
        return context.window_manager.invoke_popup(self, width=800)

    def execute(self, context: bpy.types.Context) -> set[str]:
        print("\n".join(read_log()))
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        from ..jobs.data_job import log_file

        layout = self.layout
        row = layout.row()
        row.label(text=str(log_file()), translate=False, icon="TEXT")
        row.operator("wm.path_open", text="Open Log File").filepath = str(log_file())
        column = layout.box().column(align=True)
        column.scale_y = 0.7
        for line in self._lines:
            column.label(text=line[:150], translate=False)


def read_log() -> list[str]:
    """The last lines of the log."""
    from collections import deque

    from ..jobs.data_job import log_file

    try:
        with open(log_file(), encoding="utf-8", errors="replace") as file:
            return [line.rstrip() for line in deque(file, 30)]
    except OSError as error:
        return [f"{log_file()}: {error.strerror}"]


@action("Copy Download Command", options=REGISTER)
def copy_wheel_command(context: bpy.types.Context) -> str:
    """Copy a command that downloads all packages into a folder. Run it on a machine that is online and has
    the same operating system, then select that folder here.
    """
    from ..bridge.pins import read_pins, wheel_command

    command = wheel_command(read_pins(), sys.version_info[:2])
    context.window_manager.clipboard = command
    return iface_("Copied to the clipboard: {}").format(command)
