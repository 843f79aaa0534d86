"""The work behind Estimate, Resume and Re-estimate: from the scene and its hints to results.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from ..jobs.window import push_undo
from .applying import applied_with_doubts, chosen_settings, run_of, show_doubts

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..core.run.settings import Settings, Value


def estimation(
    keep_stages: bool = False, keep_hints: bool = False, changes: Mapping[str, Value] | None = None
) -> Task:
    """Estimate materials and lights.

    Args:
        keep_stages: go on in the scene's run folder, with the stages for which room, views and settings have
            not changed; its results are replaced. Otherwise they stay, and a new run folder is made.
        keep_hints: honour the hints that the run was started with, instead of the scene's.
        changes: settings besides those of the panel, by name.
    """

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs import run_job
        from ..jobs.scene_steps import camera_step, estimation_steps

        launch = run_job.find_launch()
        settings = scene_settings(scene, changes)
        run = run_for(scene, keep_stages)
        run.create(settings)
        if not keep_hints:
            from ..blend.hints.exchange import write_for_run

            write_for_run(scene, run)
        steps = [camera_step(run), *estimation_steps(run, settings, keep_stages)]
        return run_job.open_job(run, steps, launch, note=True)

    return Task("Estimate", "estimate", make, finished=show_doubts)


def run_for(scene: bpy.types.Scene, keep_stages: bool) -> RunFolder:
    """The scene's run folder; a new one beside it where that has results already, which stay.

    Raises:
        FiptError: ``run-busy``, ``run-linked``, ``disk-full`` or ``run-unwritable``.
    """
    from ..core.run.versions import copy_capture, has_results
    from ..jobs.run_job import refuse_busy

    before = RunFolder(bpy.path.abspath(scene.fipt.run_folder)) if scene.fipt.run_folder else None
    if before is not None:
        refuse_busy(before)
        if keep_stages or not has_results(before):
            return before
        run = RunFolder(machine.new_run_folder(before.root.name, before.root.parent))
        run.create(before.read())
        copy_capture(before, run)
    else:
        run = RunFolder(machine.new_run_folder(Path(bpy.data.filepath).stem or scene.name))
    scene.fipt.run_folder = str(run.root)
    push_undo("Estimate")  # so that redo brings back what the job begins with
    return run


def scene_settings(scene: bpy.types.Scene, changes: Mapping[str, Value] | None = None) -> Settings:
    """The settings in the section Estimate; the texture settings are those of the run folder, if it has any.

    Args:
        scene: with the panel.
        changes: of other settings, by name.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``; those of `RunFolder.read`.
    """
    from ..core.run.settings import TEXTURE_SETTINGS, make_settings

    state = scene.fipt.estimate
    device = machine.device_setting() if state.device == "preferences" else state.device
    values = {**state.values(), "device": device}
    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    if scene.fipt.run_folder and run.run_json.exists():
        stored = run.read()
        values |= {name: getattr(stored, name) for name in TEXTURE_SETTINGS}
    return make_settings(state.preset, {**values, **(changes or {})})


def reestimation() -> Task:
    """Estimate materials again with the scene's hints, from the stages of the results, and apply that."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..blend.hints.exchange import write_hints_rerun
        from ..jobs.run_job import find_launch, open_job, refuse_busy
        from ..jobs.scene_steps import apply_steps, estimate_step

        run = run_of(scene)
        launch = find_launch()
        refuse_busy(run)
        chosen = chosen_settings(scene, run)
        run.create(chosen)
        settings = run.read_estimated()
        run.create(settings)
        write_hints_rerun(scene, run)
        steps = [
            estimate_step(run, settings, resume=True),
            *apply_steps(run, settings),
        ]
        return open_job(run, steps, launch, note=True)

    return Task("Re-estimate with Hints", "estimate", make, finished=applied_with_doubts, undo=True)
