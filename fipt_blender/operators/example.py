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
from ..jobs.tasks import Task
from .action import action
from .polls import has_no_capture, in_object_mode, no_job

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices

NAME = "Example Room"
FOLDER = "example"  # of the package, and of the data folder that gets its copy


@action("Try the Example", needs=(has_no_capture, in_object_mode, no_job))
def try_example(context: bpy.types.Context) -> Task:
    """Import a small room, estimate it and apply the results, in a scene of its own. Takes one to three
    minutes, because its 20 photographs have only 128 x 72 pixels.
    """
    from ..jobs.run_job import find_launch

    launch = find_launch()  # raises before anything is created
    if context.scene.objects and context.window is not None:
        context.window.scene = bpy.data.scenes.new(NAME)

    def make(scene: bpy.types.Scene) -> Job:
        from ..bridge.step import Step
        from ..core.capture.options import CaptureOptions
        from ..jobs.run_job import ingest_step, open_job
        from ..jobs.scene_steps import apply_steps, camera_step, estimation_steps, scene_named

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
            camera_step(run),
            *estimation_steps(run, settings, resume=False),
            *apply_steps(scene_named(scene.name), run, settings, estimated=True),
        ]
        return open_job(run, steps, record="example.json", launch=launch)

    return Task("Example", "estimate", make, finished=applying.note_applied, undo=True)


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
