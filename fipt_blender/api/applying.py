# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The work behind Apply Results and Versions: results become materials and lights of the scene.

Operators import it while Blender starts, so it imports heavier modules inside functions.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step
    from ..core.run.settings import Settings

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


def application() -> Task:
    """Apply the results of the scene's run to its room."""

    def make(scene: bpy.types.Scene) -> Job:
        run = run_of(scene)
        settings = chosen_settings(scene, run)
        run.create(settings)
        return _apply_job(scene, run, settings)

    return Task("Apply Results", "materials", make, finished=_applied, undo=True)


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
        return _apply_job(scene, run, settings)

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        _applied(scene, run)
        show_doubts(scene, run)

    return Task("Apply Version", "materials", make, finished=finished, undo=True)


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
        text = f"The scene shows the estimate {version}."
        raise FiptError("run-busy", text, "Apply another one first, then delete this one.")
    for _ in storage.delete_folder(run.root):
        pass
    runstate.forget(run_of(scene).root)


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


def show_doubts(scene: bpy.types.Scene, run: RunFolder) -> None:
    """List a run's questions and load their pictures."""
    from ..blend import previews
    from ..blend.hints.exchange import read_doubts

    read_doubts(scene, run)
    previews.doubt_pictures.load([Path(doubt.picture) for doubt in scene.fipt.hints.doubts])


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
        raise FiptError(
            "results-missing",
            f"The run {run.root} has no results yet.",
            "Use Estimate, or Resume if the run was stopped.",
        )
    return replace(settings, **values_of(scene.fipt.materials, TextureSettings))


def apply_steps(scene_name: str, run: RunFolder, settings: Settings) -> list[Step]:
    """Texture coordinates, baking, assignment; the first two are skipped while their inputs are the same.

    A job that estimates first must call `note_applied` at its end: the inputs are those of the results from
    before.
    """
    import uuid

    from ..bridge.step import Step
    from ..jobs.expected import atlas_seconds, texture_seconds

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

        files = texture_files(bpy.data.scenes[scene_name], run)
        applied = yield from apply_slices(run, objects(), bpy.data.scenes[scene_name], files)
        apply_environment(run, bpy.data.scenes[scene_name], files)
        return applied.warnings

    return [
        Step(
            "apply-atlas",
            "Creating texture coordinates",
            2.0,
            inputs={
                "room": _stamp(run.room_npz),
                "parts": _stamp(run.parts_npz) if settings.atlas_images == "part" else [],
                **atlas_values,
            },
            function=lay_out,
            outputs=[run.atlas_npz, run.atlas_json],
            expected=lambda: atlas_seconds(run),
        ),
        Step(
            "apply-textures",
            "Baking textures",
            25.0,
            inputs={"fields": _stamp(run.fields_npz)},
            command=["textures", str(run.root)],
            outputs=[run.textures],
            expected=lambda: texture_seconds(run, settings),
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
