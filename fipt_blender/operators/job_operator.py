# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the operators that start a job: beside the user's work in a window, waiting for it in scripts."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder, explained_write_errors
from ..jobs import running
from ..jobs.tasks import Task, begin
from .polls import all_of, no_job
from .reporting import report_warnings

if TYPE_CHECKING:
    from ..bridge.sequence import Job


class StartsJob:
    """Base of the mix-ins below: allows one job at a time and reports its end."""

    title = ""
    bl_options = {"REGISTER"}

    poll = all_of(no_job)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._start(context, wait=True)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._start(context, wait=bpy.app.background)

    def _start(self, context: bpy.types.Context, wait: bool) -> set[str]:
        """Start the job; where `wait` is set, run it to its end and report its messages."""
        try:
            info = self._begin(context, wait)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        if not wait:
            # Nothing has been done yet that could be undone or repeated.
            return {"INTERFACE"}
        report_warnings(self, info.warnings)
        if info.error is not None:
            self.report({"ERROR"}, f"{info.error['text']} {info.error['remedy']}")  # type: ignore[attr-defined]
        return {"FINISHED"} if info.state == "finished" else {"CANCELLED"}

    def _begin(self, context: bpy.types.Context, wait: bool) -> running.RunningJob:
        raise NotImplementedError


class JobOperator(StartsJob):
    """Mix-in of an operator that starts a job on a scene; put it before `bpy.types.Operator`.

    A subclass implements `task`, or sets `title` and `kind`, implements `make_job`, and may implement
    `finished` and `failed`. With "UNDO" in `bl_options`, the job's end adds an undo step. A `poll` of its own
    has `no_job` among its conditions.
    """

    kind = ""

    def make_job(self, context: bpy.types.Context) -> Job:
        """The job, ready to run, on `context.scene`.

        Raises:
            FiptError: the job can't start.
        """
        raise NotImplementedError

    # Called with the scene after a success; may raise FiptError.
    finished: Callable[[bpy.types.Scene, RunFolder], None] | None = None
    # Called with the scene after a failure or a cancellation.
    failed: Callable[[bpy.types.Scene, RunFolder], None] | None = None

    def task(self, context: bpy.types.Context) -> Task:
        """What it starts."""
        operator = type(self)
        undo = "UNDO" in operator.bl_options
        return Task(
            self.title, self.kind, lambda _: self.make_job(context), operator.finished, operator.failed, undo
        )

    def _begin(self, context: bpy.types.Context, wait: bool) -> running.RunningJob:
        return begin(self.task(context), context.scene, wait)


class DataJobOperator(StartsJob):
    """Mix-in of an operator that starts a job on the data folder; a subclass sets `title` and `make_job`."""

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None] | None]:
        """The job, ready to run, and what to call at its end, however it ends."""
        raise NotImplementedError

    def _begin(self, context: bpy.types.Context, wait: bool) -> running.RunningJob:
        data = machine.data_folder()
        with explained_write_errors(data):
            data.mkdir(parents=True, exist_ok=True)
        job, on_end = self.make_job()
        begin = running.run if wait else running.start
        return begin(job, running.RunningJob(self.title, running.DATA_KIND, "", data), on_end)
