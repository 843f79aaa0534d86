# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps from a scene with a capture and a room to its estimated materials and lights.

The buttons, the Python API and the command line (`main_job`) do the same ones.
"""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from ..bridge.process import Message
from ..bridge.step import Slices, Step, StepRecord, chain_keys
from ..core.run.errors import FiptError
from ..core.run.hints import hints_digest, read_hints
from ..core.run.method import method_digest
from ..core.run.runfolder import RunFolder
from ..core.run.settings import TEXTURE_SETTINGS, Settings
from .expected import atlas_seconds, estimate_seconds, texture_seconds

if TYPE_CHECKING:
    import bpy

_ATLAS_SETTINGS = ("atlas_mode", "atlas_images", "texture_size", "texel_density")
# Expected times until the capture is read: seconds for the example room on two idle cores.
_ESTIMATE_SECONDS = {"draft": 85.0, "medium": 150.0, "high": 2400.0}


def camera_step(run: RunFolder) -> Step:
    """What the artist has made of the cameras."""
    return Step(
        "cameras", "Reading the cameras", 1.0, function=lambda: export_scene_cameras(run), repeat=True
    )


def estimation_steps(
    run: RunFolder, settings: Settings, resume: bool, cluster: str | None = None
) -> list[Step]:
    """The steps from the current scene to the results; see `estimate_step`."""
    text = "Preparing the room for the engine"
    return [
        Step("room", text, 2.0, function=lambda: export_scene_room(run), repeat=True),
        estimate_step(run, settings, resume, cluster),
    ]


def room_steps(
    scene: Callable[[], bpy.types.Scene],
    run: RunFolder,
    settings: Settings,
    resume: bool,
    cluster: str | None = None,
) -> list[Step]:
    """The steps from a scene with a capture to its room with the results; at the end comes `note_applied`."""
    return [
        *estimation_steps(run, settings, resume, cluster),
        *apply_steps(scene, run, settings, estimated=True),
    ]


def estimate_step(
    run: RunFolder, settings: Settings, resume: bool = False, cluster: str | None = None
) -> Step:
    """The engine's estimation from the capture.json and room.npz of a run folder.

    Args:
        resume: whether the engine may keep stages that do not depend on changed settings.
        cluster: see `MainJobOptions`; not among the step's inputs, since the results do not depend on it.
    """
    values = {name: value for name, value in asdict(settings).items() if name not in TEXTURE_SETTINGS}
    return Step(
        "estimate",
        "Estimating materials and lights",
        _ESTIMATE_SECONDS.get(settings.preset, 360.0),
        inputs={**values, "method": method_digest(), "hints": _hints_digests(run)},
        command=["estimate", str(run.root), *([] if cluster is None else [f"--cluster={cluster}"])],
        outputs=[run.fields_npz, run.emitters_json],
        reset=None if resume else lambda: _empty(run.stage),
        expected=lambda: estimate_seconds(run, settings),
    )


def _hints_digests(run: RunFolder) -> list[str | None]:
    """What the run's files of hints hold, None for a file that is not there."""
    paths = (run.hints_json, run.hints_again_json)
    return [hints_digest(read_hints(path)) if path.exists() else None for path in paths]


def export_scene_cameras(run: RunFolder) -> None:
    """Write capture.json from the scene's ticked views; a scene without views keeps the existing one.

    Raises:
        FiptError: see `export_capture`.
    """
    import bpy

    from ..blend.capture.exporting import export_capture

    scene = bpy.context.scene
    if len(scene.fipt.capture.views) or not run.capture_json.exists():
        export_capture(scene, run)


def export_scene_room(run: RunFolder) -> Slices[list[Message]]:
    """Write room.npz and room.json from the objects of the scene's room.

    Returns:
        Warnings about objects in the room's collection that are not meshes.

    Raises:
        FiptError: ``room-missing``; see `export_room`.
    """
    import bpy

    from ..blend.capture.importing import not_in_room
    from ..blend.room.exporting import export_room

    scene = bpy.context.scene
    objects = scene.fipt.capture.room_objects(scene)
    if not objects:
        raise FiptError(
            "room-missing",
            "The scene has no room.",
            "Import the room's mesh or select its collection in the section Capture.",
        )
    warnings = not_in_room(scene.fipt.capture.room_members(scene))
    yield from export_room(objects, run, scene.fipt.parts.engine_source, scene.fipt.capture.completed)
    return warnings


def apply_steps(
    scene: Callable[[], bpy.types.Scene], run: RunFolder, settings: Settings, estimated: bool = False
) -> list[Step]:
    """Texture coordinates, baking, assignment; the first two are skipped while their inputs are the same.

    Args:
        scene: finds the scene, whose name may change and which undo replaces.
        run: its run folder.
        settings: of the textures.
        estimated: whether they follow an estimation in the same job, which decides what is done again. At
            the end of that job comes `note_applied`.
    """
    atlas_values = {name: getattr(settings, name) for name in _ATLAS_SETTINGS}

    def objects() -> list[bpy.types.Object]:
        return scene().fipt.capture.room_objects(scene())

    def lay_out() -> Slices[None]:
        from ..blend.room.atlas import make_atlas

        yield from make_atlas(objects(), run, settings)
        return None

    def build() -> Slices[list[Message]]:
        from ..blend.lights.world import apply_environment
        from ..blend.results.applying import apply_results
        from ..blend.texture_files import texture_files

        files = texture_files(scene(), run)
        warnings = yield from apply_results(run, objects(), scene(), files)
        if apply_environment(run, scene(), files) is None:
            text = "The scene keeps the world that you have chosen since results were applied."
            remedy = "To get the estimated one back, use Revert and apply the results again."
            warnings.append({"type": "warning", "code": "world-kept", "text": text, "remedy": remedy})
        return warnings

    return [
        Step(
            "apply-atlas",
            "Creating texture coordinates",
            2.0,
            inputs={**atlas_values, **({} if estimated else _stamps(run, settings))},
            function=lay_out,
            outputs=[run.atlas_npz, run.atlas_json],
            expected=lambda: atlas_seconds(run),
        ),
        Step(
            "apply-textures",
            "Baking textures",
            25.0,
            inputs={} if estimated else {"fields": _stamp(run.fields_npz)},
            command=["textures", str(run.root)],
            outputs=[run.textures],
            expected=lambda: texture_seconds(run, settings),
        ),
        Step(
            "apply-build",
            "Building materials and lights",
            1.0,
            # Its result is in Blender's data: it is never skipped where nothing comes after it.
            inputs={} if estimated else {"time": uuid.uuid4().hex},
            function=build,
            repeat=estimated,
        ),
    ]


def scene_named(name: str) -> Callable[[], bpy.types.Scene]:
    """Finds a scene again."""
    import bpy

    return lambda: bpy.data.scenes[name]


def applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After `apply_steps`: bring the panel and the rest of the scene up to date."""
    from ..blend.marks import ADDED, FOUND
    from ..blend.results.scene_state import finish

    finish(scene, run)
    settings = scene.fipt.capture
    # What the artist deletes of it stays away in the next estimation. Closed holes alone say nothing of the
    # search, which may find more with other masks.
    settings.completed |= any(item.get(ADDED) == FOUND for item in settings.room_objects(scene))


def note_applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After `apply_steps` in a job that has estimated: the same, and record what was baked."""
    applied(scene, run)
    steps, record = apply_steps(scene_named(scene.name), run, run.read()), StepRecord(run.apply_json)
    for step, key in zip(steps, chain_keys(steps), strict=True):
        record.store(step.name, key, finished=True)


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()


def _stamps(run: RunFolder, settings: Settings) -> dict[str, list[int]]:
    parts = _stamp(run.parts_npz) if settings.atlas_images == "part" else []
    return {"room": _stamp(run.room_npz), "parts": parts}


def _stamp(path: Path) -> list[int]:
    try:
        status = path.stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns]
