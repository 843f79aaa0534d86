"""The work behind Import: a capture is read, checked and added to the scene.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.errors import FiptError, warning
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..bridge.process import Message


def capture_import() -> Task:
    """Import the capture that the panel names."""
    return Task("Import Capture", "capture", _import_capture, failed=give_back, undo=True)


def _import_capture(scene: bpy.types.Scene) -> Job:
    from ..blend.capture.importing import import_capture
    from ..core.capture.options import CaptureOptions
    from ..core.run.declared import converted
    from ..jobs.options import capture_source
    from ..jobs.run_job import find_launch, open_job
    from ..jobs.scene_steps import import_steps
    from ..properties.declared import values_of

    settings = scene.fipt.capture
    if not settings.path:
        raise FiptError("capture-missing.import-capture")
    path = Path(bpy.path.abspath(settings.path)).absolute()
    if not path.exists():
        raise FiptError("capture-missing.import-capture-2", path=path)
    path = capture_source(path)
    options = CaptureOptions(**converted(CaptureOptions, values_of(settings, CaptureOptions)))
    options.refuse_missing()
    launch = find_launch()  # raises before anything is created
    run = open_run(scene, str(path), path.stem if path.is_file() else path.name)
    return open_job(run, import_steps(run, path, options, partial(import_capture, run, str(path))), launch)


def run_opening(folder: Path) -> Task:
    """Go on with a run that no saved file knows: its cameras and its mesh come into the scene."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..blend.capture.importing import import_capture
        from ..bridge.step import Step
        from ..jobs.run_job import open_job

        run = RunFolder(folder)
        source = run.unsaved.read_text(encoding="utf-8")
        work = partial(import_capture, run, source)
        job = open_job(run, [Step("import", "Adding cameras and mesh", 5.0, function=work)])
        scene.fipt.capture.path, scene.fipt.run_folder = source, str(run.root)
        return job

    def failed(scene: bpy.types.Scene, run: RunFolder) -> None:
        scene.fipt.run_folder = ""

    return Task("Open Run", "capture", make, failed=failed, undo=True)


def scene_cameras_import() -> Task:
    """Use the scene's own cameras, with their background images, as the capture."""
    return Task("Use Scene Cameras", "capture", _use_scene_cameras, failed=give_back, undo=True)


def _use_scene_cameras(scene: bpy.types.Scene) -> Job:
    from ..blend.capture.scene_cameras import SCENE_SOURCE, adopt_cameras, write_scene_cameras
    from ..core.capture.options import CaptureOptions
    from ..jobs.run_job import find_launch, open_job
    from ..jobs.scene_steps import import_steps

    settings = scene.fipt.capture
    launch = find_launch()  # raises before anything is created
    name = bpy.path.display_name_from_filepath(bpy.data.filepath) or scene.name
    run = open_run(scene, SCENE_SOURCE, name)
    try:
        path, skipped = write_scene_cameras(scene, run)
    except FiptError:
        give_back(scene, run)
        raise
    options = CaptureOptions(
        format="transforms",
        up_axis="z",
        hold_back=settings.hold_back,
        layer=settings.layer,
        colorspace=settings.colorspace,
        clamp_negative=settings.clamp_negative,
        own_paths=True,
        keep_poses=True,  # the artist's
    )

    def adopt() -> list[Message]:
        adopt_cameras(run)
        if not skipped:
            return []
        return [warning("cameras-left-out", count=len(skipped), first=", ".join(skipped[:5]))]

    return open_job(run, import_steps(run, path, options, adopt, "Listing the cameras"), launch)


def open_run(scene: bpy.types.Scene, source: str, name: str) -> RunFolder:
    """The scene's run folder, or a new one if it has none or that holds another capture or none."""
    import shutil

    from ..core.run.settings import make_settings

    settings, previous = scene.fipt.capture, scene.fipt.run_folder
    settings.previous_run = previous
    run = RunFolder(bpy.path.abspath(previous)) if previous else None
    if run is not None and machine.is_unused_run(run.root):
        # Of a first import that failed, with the name of what it tried to import.
        shutil.rmtree(run.root, ignore_errors=True)
        settings.previous_run, run = "", None
    if run is None or (run.capture_json.exists() and settings.imported_path != source):
        run = RunFolder(machine.new_run_folder(name))
    if not run.run_json.exists():
        run.create(make_settings())
        run.unsaved.write_text(source, encoding="utf-8")
    run.made("capture").unlink(missing_ok=True)  # the artist wants it read
    scene.fipt.run_folder = str(run.root)
    return run


def give_back(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After a failed import: give the scene its previous run folder back and delete the new one."""
    import shutil

    previous = scene.fipt.capture.previous_run
    if previous and previous != scene.fipt.run_folder:
        scene.fipt.run_folder = previous
        shutil.rmtree(run.root, ignore_errors=True)
