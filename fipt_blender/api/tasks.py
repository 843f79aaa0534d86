# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The work behind buttons and Python API: import, estimation, application of results, change of version.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from ..jobs.window import push_undo

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step, StepFunction
    from ..core.capture.options import CaptureOptions
    from ..core.run.settings import Settings, Value
    from ..properties.capture import FIPT_CaptureSettings

_CAPTURE_SETTINGS = (
    *("format", "up_axis", "clamp_negative", "align_mesh", "plane_room", "dense_stereo", "triangles"),
    "undo_applied_transform",
)
_ATLAS_SETTINGS = ("atlas_mode", "atlas_images", "texture_size", "texel_density")


def run_of(scene: bpy.types.Scene) -> RunFolder:
    """The run folder of a scene.

    Raises:
        FiptError: ``run-missing`` where it has none.
    """
    if not scene.fipt.run_folder:
        raise FiptError(
            "run-missing", f"The scene '{scene.name}' has no run.", "Import a capture and estimate it first."
        )
    return RunFolder(bpy.path.abspath(scene.fipt.run_folder))


# Import


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
    return CaptureOptions(
        mesh=mesh,
        images=images,
        scale=float(settings.scale),
        hold_back=0 if settings.hold_back < 2 else settings.hold_back,
        **{name: getattr(settings, name) for name in _CAPTURE_SETTINGS},
    )


# Estimation


def estimation(
    keep_stages: bool = False, keep_hints: bool = False, changes: Mapping[str, Value] | None = None
) -> Task:
    """Estimate materials and lights.

    Args:
        keep_stages: keep finished stages where room, views and settings have not changed for them.
        keep_hints: honour the hints that the run was started with, instead of the scene's.
        changes: settings besides those of the panel, by name.
    """

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs import run_job

        launch = run_job.find_launch()
        settings = scene_settings(scene, changes)
        if not scene.fipt.run_folder:
            name = Path(bpy.data.filepath).stem or scene.name
            scene.fipt.run_folder = str(machine.new_run_folder(name))
            push_undo("Estimate")
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        run_job.refuse_busy(run)
        run.create(settings)
        if not keep_hints:
            from ..blend.hints.exchange import write_for_run

            write_for_run(scene, run)
        return run_job.open_job(
            run,
            make_steps(run, settings, keep_stages),
            resume=keep_stages,
            result=lambda: result_files(run),
            launch=launch,
        )

    return Task("Estimate", "estimate", make, finished=show_doubts)


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


def make_steps(run: RunFolder, settings: Settings, resume: bool) -> list[Step]:
    """The steps from the current scene to the results; see `estimate_step`."""
    from ..bridge.step import Step
    from ..jobs.main_job import EXPORT_TEXT, estimate_step

    def cameras() -> None:
        from ..jobs.room_steps import export_scene_cameras

        export_scene_cameras(run)

    def room() -> Slices[list[Message]]:
        from ..jobs.room_steps import export_scene_room

        return export_scene_room(run)

    # Seconds on a small capture, for the progress bar only.
    return [
        Step("cameras", "Reading the cameras", 1.0, function=cameras, repeat=True),
        Step("room", EXPORT_TEXT, 2.0, function=room, repeat=True),
        estimate_step(run, settings, resume),
    ]


def result_files(run: RunFolder) -> list[str]:
    """Paths of the files that an estimation writes for the other sections."""
    paths = [run.fields_npz, run.emitters_json, run.environment_exr, run.statistics_json]
    return [str(path) for path in paths if path.exists()]


def reestimation() -> Task:
    """Estimate materials again with the scene's hints, from the stages of the results, and apply that."""

    def make(scene: bpy.types.Scene) -> Job:
        from dataclasses import replace

        from ..blend.hints.exchange import write_for_again
        from ..core.run.versions import refuse_other_stages, restore_inputs
        from ..jobs.main_job import estimate_step
        from ..jobs.run_job import find_launch, open_job, refuse_busy

        run = run_of(scene)
        launch = find_launch()
        refuse_busy(run)
        chosen = chosen_settings(scene, run)
        refuse_other_stages(run)
        restore_inputs(run)
        run.create(chosen)
        kept = scene_settings(scene).kept_versions
        settings = replace(run.read_estimated(), kept_versions=kept)
        run.create(settings)
        write_for_again(scene, run)
        steps = [estimate_step(run, settings, resume=True), *apply_steps(scene.name, run, settings)]
        return open_job(run, steps, resume=False, launch=launch)

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        note_applied(scene, run)
        show_doubts(scene, run)

    return Task("Re-estimate with Hints", "estimate", make, finished=finished, undo=True)


def show_doubts(scene: bpy.types.Scene, run: RunFolder) -> None:
    """List a run's questions and load their pictures."""
    from ..blend.hints.exchange import read_doubts
    from ..jobs import previews

    read_doubts(scene, run)
    previews.doubt_pictures.load([Path(doubt.picture) for doubt in scene.fipt.hints.doubts])


# Results


def application() -> Task:
    """Apply the results of the scene's run to its room."""

    def make(scene: bpy.types.Scene) -> Job:
        run = run_of(scene)
        settings = chosen_settings(scene, run)
        run.create(settings)
        return _apply_job(scene, run, settings)

    return Task("Apply Results", "materials", make, finished=_applied, undo=True)


def version_change(version: str) -> Task:
    """Make a version the results of the scene's run, and apply it."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs.run_job import switch_version

        run = run_of(scene)
        settings = chosen_settings(scene, run)
        switch_version(run, version)
        run.create(settings)
        return _apply_job(scene, run, settings)

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        _applied(scene, run)
        show_doubts(scene, run)

    return Task("Use Version", "materials", make, finished=finished, undo=True)


def _apply_job(scene: bpy.types.Scene, run: RunFolder, settings: Settings) -> Job:
    from ..jobs.run_job import open_job

    return open_job(
        run,
        apply_steps(scene.name, run, settings),
        record=run.apply_json.name,
        resume=True,
        result=lambda: [str(path) for path in sorted(run.textures.glob("*.*"))],
    )


def _applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    from ..blend.marks import ADDED, FOUND
    from ..blend.results.scene_state import finish

    finish(scene, run)
    settings = scene.fipt.capture
    # What the artist deletes of it stays away in the next estimation. Closed holes alone say nothing of the
    # search, which may find more with other masks.
    settings.completed |= any(item.get(ADDED) == FOUND for item in settings.room_objects(scene))


def chosen_settings(scene: bpy.types.Scene, run: RunFolder) -> Settings:
    """The run's settings, with the texture settings of the panel.

    Raises:
        FiptError: ``run-missing`` and others of `RunFolder.read`; ``results-missing``.
    """
    from dataclasses import replace

    settings = run.read()
    run.recover()
    if not run.fields_npz.is_file() or not run.emitters_json.is_file():
        raise FiptError(
            "results-missing",
            f"The run {run.root} has no results yet.",
            "Use Estimate, or Resume if the run was stopped.",
        )
    panel = scene.fipt.materials
    return replace(
        settings,
        atlas_mode=panel.atlas_mode,
        atlas_images=panel.atlas_images,
        texture_size=int(panel.texture_size),
        texel_density=panel.texel_density,
        write_back=panel.write_back,
        clean_mesh=panel.clean_mesh,
    )


def apply_steps(scene_name: str, run: RunFolder, settings: Settings) -> list[Step]:
    """Texture coordinates, baking, assignment; the first two are skipped while their inputs are the same.

    A job that estimates first must call `note_applied` at its end: the inputs are those of the results from
    before.
    """
    import uuid

    from ..bridge.step import Step

    atlas_values = {name: getattr(settings, name) for name in _ATLAS_SETTINGS}

    def objects() -> list[bpy.types.Object]:
        scene = bpy.data.scenes[scene_name]
        return scene.fipt.capture.room_objects(scene)

    def lay_out() -> Slices[None]:
        from ..blend.room.atlas import atlas_slices

        yield from atlas_slices(objects(), run, settings)
        return None

    def build() -> Slices[list[Message]]:
        from ..blend.lights.world import apply_environment
        from ..blend.results.applying import apply_slices
        from ..blend.texture_files import texture_files

        files = texture_files(bpy.data.scenes[scene_name])
        applied = yield from apply_slices(run, objects(), bpy.data.scenes[scene_name], files)
        apply_environment(run, bpy.data.scenes[scene_name], files)
        return applied.warnings

    return [
        Step(
            "apply-atlas",
            "Creating texture coordinates",
            2.0,
            inputs={
                "room": _stamp(run.estimated().room_npz),
                "parts": _stamp(run.parts_npz) if settings.atlas_images == "part" else [],
                **atlas_values,
            },
            function=lay_out,
            outputs=[run.atlas_npz, run.atlas_json],
        ),
        Step(
            "apply-textures",
            "Baking textures",
            25.0,
            inputs={"fields": _stamp(run.fields_npz)},
            command=["textures", str(run.root)],
            outputs=[run.textures],
        ),
        Step(
            "apply-build",
            "Building materials and lights",
            1.0,
            inputs={"time": uuid.uuid4().hex},  # never skipped: its result is in the .blend file
            function=build,
        ),
    ]


def note_applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After `apply_steps` in a job that has estimated: bring the panel up to date, record what was baked."""
    from ..bridge.step import StepRecord, chain_keys

    _applied(scene, run)
    steps, record = apply_steps(scene.name, run, run.read()), StepRecord(run.apply_json)
    for step, key in zip(steps, chain_keys(steps), strict=True):
        record.store(step.name, key, finished=True)


def _stamp(path: Path) -> list[int]:
    try:
        status = path.stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns]
