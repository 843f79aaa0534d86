# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: the engine's set-up, its check and its log."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import preferences, running
from ..bridge.interpreter import engine_command, engine_environment, setup_command
from ..bridge.pins import other_versions, read_pins, wheel_command
from ..bridge.process import EngineProcess
from ..bridge.sequence import Job, Step, StepRecord
from ..core.job.errors import FiptError
from ..core.job.runfolder import PRODUCT_VERSION, explained_write_errors

KIND = "environment"
_LOG_LINES = 30
_RECORD = "environment.json"


def log_file() -> Path:
    """The log of set-up and check."""
    return preferences.data_folder() / "environment.log"


class DataJobOperator:
    """Mix-in of an operator that starts a job without a run folder and without a scene.

    A subclass sets `title` and implements `make_job`; `ended` is called at the end, whatever it is.
    """

    title = ""
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        busy = running.current()
        if busy is not None:
            cls.poll_message_set(iface_("{} is running").format(iface_(busy.title)))  # type: ignore[attr-defined]
            return False
        return True

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        """The job, ready to run, and what to call at its end."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._start(running.run)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._start(running.run if bpy.app.background else running.start)

    def _start(self, begin: Callable[..., running.RunningJob]) -> set[str]:
        data = preferences.data_folder()
        try:
            with explained_write_errors(data):
                data.mkdir(parents=True, exist_ok=True)
            job, ended = self.make_job()
            info = begin(job, title=self.title, kind=KIND, scene_name="", run_folder=data, on_end=ended)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        if begin is running.start:
            return {"INTERFACE"}
        for message in info.warnings:
            self.report({"WARNING"}, f"{message['text']} {message['remedy']}")  # type: ignore[attr-defined]
        if info.error is not None:
            self.report({"ERROR"}, f"{info.error['text']} {info.error['remedy']}")  # type: ignore[attr-defined]
        return {"FINISHED"} if info.state == "finished" else {"CANCELLED"}


def data_job(steps: list[Step], result: Callable[[], tuple[list[str], dict[str, Any]]] | None = None) -> Job:
    """A job of steps that start their own processes or are functions, on the data folder."""

    def start_engine(arguments: Any) -> EngineProcess:
        raise AssertionError(f"no step of this job has an engine command: {arguments}")

    data = preferences.data_folder()
    (data / _RECORD).unlink(missing_ok=True)
    record = StepRecord(data / _RECORD)
    return Job(steps, record, start_engine, log_file(), result or (lambda: ([], {})), resume=False)


class EngineStatus:
    """Collects what set-up and check say, and keeps it with the preferences at the end."""

    def __init__(self) -> None:
        self._check: EngineProcess | None = None

    def check_step(self) -> Step:
        """The step that looks at the engine."""
        return Step("check", "Checking the engine", 20.0, process=self._start_check)

    def _start_check(self) -> EngineProcess:
        values = preferences.get_preferences()
        python = preferences.engine_python()
        arguments = ["check", f"--device={values.device}"]
        gpu = preferences.chosen_gpu()
        if gpu:
            arguments.append(f"--gpu={gpu}")
        command = engine_command(python, *arguments)
        self._check = start_process(command, engine_environment(python))
        return self._check

    def store(self, info: running.RunningJob) -> None:
        """Keep the outcome; a cancelled job leaves what is known."""
        if info.state == "cancelled":
            return
        done = self._check.done if self._check is not None else None
        engine = {} if done is None else done["data"]
        if engine and (others := other_versions(read_pins(), engine["packages"])):
            info.warnings.append(
                {
                    "type": "warning",
                    "code": "package-version",
                    "text": f"Packages have other versions than the tested ones: {', '.join(others)}.",
                    "remedy": "If the engine fails, install the tested versions, given in brackets.",
                }
            )
        preferences.store_status(
            {
                "time": time.time(),
                "product_version": PRODUCT_VERSION,
                "engine": engine,
                "warnings": info.warnings,
                "error": info.error,
            }
        )


def start_process(command: list[str], environment: dict[str, str]) -> EngineProcess:
    """Start a process whose log is that of the environment.

    Raises:
        FiptError: ``engine-missing`` where its interpreter can't be started.
    """
    try:
        return EngineProcess(command, log_file(), environment)
    except OSError as error:
        raise FiptError(
            "engine-missing",
            f"{command[0]} can't be started ({error.strerror}).",
            "Name another interpreter, or set up the engine.",
        ) from error


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
        values, data = preferences.get_preferences(), preferences.data_folder()
        wheels = Path(bpy.path.abspath(values.wheel_folder)) if values.wheel_folder else None
        if wheels is not None and not wheels.is_dir():
            raise FiptError(
                "wheels-missing", f"The folder of wheels {wheels} does not exist.", "Choose another folder."
            )
        status = EngineStatus()
        command = setup_command(Path(sys.executable), data, values.device, wheels)
        step = Step(
            "set-up",
            "Setting up the engine",
            180.0,
            process=lambda: start_process(command, engine_environment()),
        )
        return data_job([step, status.check_step()]), status.store


class FIPT_OT_check_engine(DataJobOperator, bpy.types.Operator):
    """Try the engine on this machine and say what is missing and how to mend it"""

    bl_idname = "fipt.check_engine"
    bl_label = "Check"
    title = "Check Engine"

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        status = EngineStatus()
        return data_job([status.check_step()]), status.store


class FIPT_OT_cancel_set_up(bpy.types.Operator):
    """Stop; what was downloaded is kept for the next time"""

    bl_idname = "fipt.cancel_set_up"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        busy = running.current()
        if busy is None or busy.kind != KIND:
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
        known = preferences.get_preferences().status or running.current() or running.last(KIND)
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
