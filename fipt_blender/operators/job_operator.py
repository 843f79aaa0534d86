# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators that start a job share: beside the user's work in a window, to its end for scripts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import preferences, running
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, explained_write_errors

if TYPE_CHECKING:
    from ..bridge.sequence import Job

DATA_KIND = "environment"


class _StartsJob:
    """What both mix-ins below share: one job at a time, and how its end is told."""

    title = ""
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        busy = running.current()
        if busy is not None:
            cls.poll_message_set(iface_("{} is running").format(iface_(busy.title)))  # type: ignore[attr-defined]
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._start(context, beside=False)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._start(context, beside=not bpy.app.background)

    def _start(self, context: bpy.types.Context, beside: bool) -> set[str]:
        """Start the job, beside the user's work or to its end, and report."""
        try:
            info = self._begin(context, beside)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        if beside:
            # Nothing is done yet that could be undone or repeated.
            return {"INTERFACE"}
        for message in info.warnings:
            self.report({"WARNING"}, f"{message['text']} {message['remedy']}")  # type: ignore[attr-defined]
        if info.error is not None:
            self.report({"ERROR"}, f"{info.error['text']} {info.error['remedy']}")  # type: ignore[attr-defined]
        return {"FINISHED"} if info.state == "finished" else {"CANCELLED"}

    def _begin(self, context: bpy.types.Context, beside: bool) -> running.RunningJob:
        raise NotImplementedError


class JobOperator(_StartsJob):
    """Mix-in of an operator that starts a job on a scene; put it before `bpy.types.Operator`.

    A subclass sets `title` and `kind`, implements `make_job`, and may implement `finished`. With "UNDO" in
    its `bl_options` the job's end becomes an undo step. Extend `poll` with `super().poll(context)`.
    """

    kind = ""

    def make_job(self, context: bpy.types.Context) -> Job:
        """The job, ready to run, on `context.scene`.

        Raises:
            FiptError: what the user has to mend first.
        """
        raise NotImplementedError

    # What to do with the scene, looked up afresh, when all went well; may raise FiptError.
    finished: Callable[[bpy.types.Scene, RunFolder], None] | None = None
    # The same where it failed or was cancelled.
    failed: Callable[[bpy.types.Scene, RunFolder], None] | None = None

    def _begin(self, context: bpy.types.Context, beside: bool) -> running.RunningJob:
        scene, kind = context.scene, type(self)
        begin = running.start if beside else running.run
        names = {"title": self.title, "kind": self.kind, "scene_name": scene.name}
        try:
            job = self.make_job(context)
            folder = Path(bpy.path.abspath(scene.fipt.run_folder))
            return begin(job, **names, run_folder=folder, on_end=lambda info: _end(info, kind, beside))
        except FiptError as error:
            running.refuse(error, **names, run_folder=Path(bpy.path.abspath(scene.fipt.run_folder)))
            raise


class DataJobOperator(_StartsJob):
    """Mix-in of an operator that starts a job without a run folder and without a scene.

    A subclass sets `title` and implements `make_job`; `ended` is called at the end, whatever it is.
    """

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        """The job, ready to run, and what to call at its end."""
        raise NotImplementedError

    def _begin(self, context: bpy.types.Context, beside: bool) -> running.RunningJob:
        data = preferences.data_folder()
        with explained_write_errors(data):
            data.mkdir(parents=True, exist_ok=True)
        job, ended = self.make_job()
        begin = running.start if beside else running.run
        return begin(job, title=self.title, kind=DATA_KIND, scene_name="", run_folder=data, on_end=ended)


def _end(info: running.RunningJob, kind: type[JobOperator], beside: bool) -> None:
    scene = running.find_scene(info.scene_name, info.run_folder)
    if scene is None:
        return
    if info.state != "finished":
        if kind.failed is not None:
            kind.failed(scene, RunFolder(info.run_folder))
        return
    if kind.finished is not None:
        kind.finished(scene, RunFolder(info.run_folder))
    if beside and "UNDO" in kind.bl_options:
        running.push_undo(kind.title)
