# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From an empty panel to an estimated room in one click: a small capture that comes with the extension."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..api import applying, estimating
from ..core.run.runfolder import RunFolder, explained_write_errors
from ..jobs import running
from .job_operator import JobOperator
from .polls import all_of, has_no_capture, in_object_mode, no_job

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices

NAME = "Example Room"
FOLDER = "example"  # of the package, and of the data folder that gets its copy


class FIPT_OT_try_example(JobOperator, bpy.types.Operator):
    bl_idname = "fipt.try_example"
    bl_label = "Try the Example"
    bl_description = (
        "Import a small room, estimate it and apply the results, in a scene of its own. Takes one to three"
        " minutes, because its 20 photographs have only 128 x 72 pixels"
    )
    bl_options = {"REGISTER", "UNDO"}
    title = "Example"
    kind = "estimate"

    poll = all_of(has_no_capture, in_object_mode, no_job)

    def _begin(self, context: bpy.types.Context, wait: bool) -> running.RunningJob:
        from ..jobs.run_job import find_launch

        self._launch = find_launch()  # raises before anything is created
        if context.scene.objects and context.window is not None:
            context.window.scene = bpy.data.scenes.new(NAME)
        return super()._begin(context, wait)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..bridge.step import Step
        from ..core.capture.options import CaptureOptions
        from ..jobs.run_job import ingest_step, open_job

        scene = context.scene
        path = copy_example(machine.data_folder())
        scene.fipt.capture.path = str(path)
        scene.fipt.estimate.preset = "draft"
        settings = estimating.scene_settings(scene)
        run = RunFolder(machine.new_run_folder(NAME))
        run.create(settings)
        scene.fipt.run_folder = str(run.root)

        def add_to_scene() -> Slices[list[Message]]:
            from ..blend.capture.importing import import_capture

            return import_capture(run, str(path))

        steps = [
            ingest_step(run, path, CaptureOptions(), "Reading the example", 2.0),
            Step("import", "Adding cameras and mesh", 1.0, function=add_to_scene),
            *estimating.make_steps(run, settings, resume=False),
            *applying.apply_steps(scene.name, run, settings),
        ]
        return open_job(run, steps, record="example.json", launch=self._launch)

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        """Show the estimated room from inside."""
        applying.note_applied(scene, run)


def copy_example(data: Path) -> Path:
    """Copy the example to the data folder, since upgrades of the extension delete its own; returns its place.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    import shutil

    from ..bridge.places import PACKAGE_FOLDER

    target = data / FOLDER
    with explained_write_errors(target):
        shutil.copytree(PACKAGE_FOLDER / FOLDER, target, dirs_exist_ok=True)
    return target
