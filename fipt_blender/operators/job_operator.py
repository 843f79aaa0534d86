# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators that start a job share: beside the user's work in a window, to its end for scripts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import running
from ..bridge.sequence import Job
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder


class JobOperator:
    """Mix-in of an operator that starts a job; put it before `bpy.types.Operator`.

    A subclass sets `title` and `kind`, implements `make_job`, and may implement `finished`. With "UNDO" in
    its `bl_options` the job's end becomes an undo step. Extend `poll` with `super().poll(context)`.
    """

    title = ""
    kind = ""
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        busy = running.current()
        if busy is not None:
            cls.poll_message_set(iface_("{} is running").format(iface_(busy.title)))  # type: ignore[attr-defined]
            return False
        return True

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

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._start(context, running.run)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._start(context, running.run if bpy.app.background else running.start)

    def _start(self, context: bpy.types.Context, begin: Callable[..., running.RunningJob]) -> set[str]:
        scene, kind = context.scene, type(self)
        beside = begin is running.start
        names = {"title": self.title, "kind": self.kind, "scene_name": scene.name}
        try:
            job = self.make_job(context)
            folder = Path(bpy.path.abspath(scene.fipt.run_folder))
            info = begin(job, **names, run_folder=folder, on_end=lambda info: _end(info, kind, beside))
        except FiptError as error:
            running.refuse(error, **names, run_folder=Path(bpy.path.abspath(scene.fipt.run_folder)))
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
