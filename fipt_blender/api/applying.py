"""The work behind Apply Results and Versions: results become materials and lights of the scene.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..core.run.settings import Settings


def run_of(scene: bpy.types.Scene) -> RunFolder:
    """The run folder of a scene.

    Raises:
        FiptError: ``run-missing`` where it has none.
    """
    if not scene.fipt.run_folder:
        raise FiptError("run-missing.run-of", name=scene.name)
    return RunFolder(bpy.path.abspath(scene.fipt.run_folder))


def application() -> Task:
    """Apply the results of the scene's run to its room."""

    def make(scene: bpy.types.Scene) -> Job:
        run = run_of(scene)
        settings = chosen_settings(scene, run)
        run.create(settings)
        return _apply_job(run, settings)

    return Task("Apply Results", "materials", make, finished=applied, undo=True)


def version_change(version: str) -> Task:
    """Make a version, by the name of its folder, the scene's run, and apply it."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..core.run.versions import find_version
        from ..jobs.run_job import refuse_busy

        run = find_version(run_of(scene), version)
        refuse_busy(run)
        settings = chosen_settings(scene, run)
        run.create(settings)
        scene.fipt.run_folder = str(run.root)
        return _apply_job(run, settings)

    return Task("Apply Version", "materials", make, finished=applied_with_doubts, undo=True)


def delete_version(scene: bpy.types.Scene, version: str) -> None:
    """Delete the run folder of a version, by its name.

    Raises:
        FiptError: ``version-missing``, ``run-busy`` where it is in use, ``run-unwritable``.
    """
    from ..bridge import storage
    from ..core.run.versions import find_version
    from ..jobs import runstate
    from ..jobs.run_job import refuse_busy

    run = find_version(run_of(scene), version)
    refuse_busy(run)
    if any(each.fipt.run_folder and run_of(each).root == run.root for each in bpy.data.scenes):
        raise FiptError("run-busy.delete-version", version=version)
    for _ in storage.delete_folder(run.root):
        pass
    runstate.forget(run_of(scene).root)


def _apply_job(run: RunFolder, settings: Settings) -> Job:
    from ..jobs.run_job import open_job
    from ..jobs.scene_steps import apply_steps

    return open_job(run, apply_steps(run, settings))


def applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    """See `scene_steps.applied`."""
    from ..jobs import scene_steps

    scene_steps.applied(scene, run)


def applied_with_doubts(scene: bpy.types.Scene, run: RunFolder) -> None:
    """What follows when another estimate is applied."""
    applied(scene, run)
    show_doubts(scene, run)


def show_doubts(scene: bpy.types.Scene, run: RunFolder) -> None:
    """List a run's questions; the panel reads their pictures anew."""
    from ..blend import previews
    from ..blend.hints.exchange import read_doubts

    read_doubts(scene, run)
    previews.doubt_pictures.clear()


def chosen_settings(scene: bpy.types.Scene, run: RunFolder) -> Settings:
    """The run's settings, with the texture settings of the panel.

    Raises:
        FiptError: ``run-missing`` and others of `RunFolder.read`; ``results-missing``.
    """
    from dataclasses import replace

    from ..core.run.stage_settings import TextureSettings
    from ..properties.declared import values_of

    settings = run.read()
    run.recover()
    if not run.fields_npz.is_file() or not run.emitters_json.is_file():
        raise FiptError("results-missing.chosen-settings", root=run.root)
    return replace(settings, **values_of(scene.fipt.materials, TextureSettings))
