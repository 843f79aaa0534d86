# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The work behind Import: a capture is read, checked and added to the scene.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, StepFunction
    from ..core.capture.options import CaptureOptions
    from ..properties.capture import FIPT_CaptureSettings

_CAPTURE_SETTINGS = (
    *("format", "up_axis", "layer", "clamp_negative", "triangles", "undo_applied_transform"),
)


def capture_import() -> Task:
    """Import the capture that the panel names."""
    return Task("Import Capture", "capture", _import_capture, failed=give_back, undo=True)


def _import_capture(scene: bpy.types.Scene) -> Job:
    from ..jobs.options import capture_source

    settings = scene.fipt.capture
    if not settings.path:
        raise FiptError(
            "capture-missing",
            "No capture is selected.",
            "Select its folder or camera file in the section Capture.",
        )
    path = Path(bpy.path.abspath(settings.path)).absolute()
    if not path.exists():
        raise FiptError(
            "capture-missing",
            f"The capture {path} does not exist.",
            "Select the folder that contains the cameras, or the camera file itself, as Capture.",
        )
    path = capture_source(path)
    arguments = _capture_options(settings).arguments()
    machine.engine_python()  # raises before anything is created
    run = open_run(scene, str(path), path.stem if path.is_file() else path.name)

    def add_to_scene() -> Slices[list[Message]]:
        from ..blend.capture.importing import import_capture

        return import_capture(run, str(path))

    return import_job(run, path, arguments, "Adding cameras and mesh", add_to_scene)


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
    scene.fipt.run_folder = str(run.root)
    return run


def give_back(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After a failed import: give the scene its previous run folder back and delete the new one."""
    import shutil

    previous = scene.fipt.capture.previous_run
    if previous and previous != scene.fipt.run_folder:
        scene.fipt.run_folder = previous
        shutil.rmtree(run.root, ignore_errors=True)


def import_job(
    run: RunFolder, path: Path, arguments: list[str], text: str, add_to_scene: StepFunction
) -> Job:
    """The engine reads and checks a capture; then it is added to the scene."""
    from ..bridge.step import Step
    from ..jobs.run_job import ingest_step, open_job

    steps = [
        ingest_step(run, path, arguments, "Reading and checking the photographs", 20.0),
        Step("import", text, 5.0, function=add_to_scene, repeat=True),
    ]
    return open_job(run, steps, record="import.json")


def _capture_options(settings: FIPT_CaptureSettings) -> CaptureOptions:
    """The import settings of the panel.

    Raises:
        FiptError: ``mesh-missing`` or ``images-missing``.
    """
    from ..core.capture.options import CaptureOptions

    mesh = Path(bpy.path.abspath(settings.mesh)).absolute() if settings.mesh else None
    if mesh is not None and not mesh.is_file():
        raise FiptError(
            "mesh-missing",
            f"The mesh {mesh} does not exist.",
            "Select another file as Mesh in Import Settings, or clear the field.",
        )
    images = Path(bpy.path.abspath(settings.images)).absolute() if settings.images else None
    if images is not None and not images.is_dir():
        raise FiptError(
            "images-missing",
            f"The folder {images} does not exist.",
            "Select another folder as Photographs in Import Settings, or clear the field.",
        )
    panorama = Path(bpy.path.abspath(settings.panorama)).absolute() if settings.panorama else None
    return CaptureOptions(
        mesh=mesh,
        panorama=panorama,
        panorama_place=tuple(settings.panorama_place),
        panorama_heading=math.degrees(settings.panorama_heading),
        images=images,
        scale=float(settings.scale),
        hold_back=0 if settings.hold_back < 2 else settings.hold_back,
        **{name: getattr(settings, name) for name in _CAPTURE_SETTINGS},
    )
