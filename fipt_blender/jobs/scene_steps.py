"""The steps from a capture to a scene with its estimated materials and lights.

The buttons, the Python API and the command line (`main_job`) do the same ones. Each does what is missing.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..bridge.process import Message
from ..bridge.step import Slices, Step, StepFunction
from ..core.capture.options import CaptureOptions
from ..core.run.errors import FiptError, warning
from ..core.run.made import Made, content_digest
from ..core.run.runfolder import RunFolder
from ..core.run.settings import Settings
from .expected import atlas_seconds, estimate_seconds, texture_seconds

if TYPE_CHECKING:
    import bpy

# Settings of the atlas; the preset decides how large its images are.
_ATLAS_SETTINGS = ("atlas_mode", "atlas_images", "texture_size", "texel_density", "detail", "preset")
# Expected times until the capture is read: seconds for the example room on two idle cores.
_ESTIMATE_SECONDS = {"draft": 85.0, "medium": 150.0, "high": 2400.0}


def import_steps(
    run: RunFolder,
    capture: Path,
    options: CaptureOptions,
    add_to_scene: StepFunction,
    text: str = "Adding cameras and mesh",
) -> list[Step]:
    """The engine reads and checks a capture, which then is added to the scene.

    Args:
        run: the run folder into which it is read.
        capture: folder or file.
        options: how it is read.
        add_to_scene: what is done then; `text` is shown meanwhile.
    """
    command = ["ingest", str(capture), str(run.root), *options.arguments()]
    return [
        Step("ingest", "Reading and checking the photographs", 20.0, command=command),
        Step("import", text, 5.0, function=add_to_scene),
    ]


def camera_step(run: RunFolder) -> Step:
    """What the artist has made of the cameras."""
    return Step("cameras", "Reading the cameras", 1.0, function=lambda: export_scene_cameras(run))


def estimation_steps(
    run: RunFolder, settings: Settings, resume: bool, cluster: str | None = None
) -> list[Step]:
    """The steps from the current scene to the results; see `estimate_step`."""
    text = "Preparing the room for the engine"
    return [
        Step("room", text, 2.0, function=lambda: export_scene_room(run)),
        estimate_step(run, settings, resume, cluster),
    ]


def estimate_step(run: RunFolder, settings: Settings, resume: bool, cluster: str | None = None) -> Step:
    """The engine's estimation from the capture.json and room.npz of a run folder.

    Args:
        resume: whether the engine may keep stages that do not depend on what has changed.
        cluster: see `MainJobOptions`.
    """
    options = [*([] if resume else ["--anew"]), *([] if cluster is None else [f"--cluster={cluster}"])]
    return Step(
        "estimate",
        "Estimating materials and lights",
        _ESTIMATE_SECONDS.get(settings.preset, 360.0),
        command=["estimate", str(run.root), *options],
        expected=lambda: estimate_seconds(run, settings),
    )


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
        raise FiptError("room-missing.export-scene-room")
    warnings = not_in_room(scene.fipt.capture.room_members(scene))
    yield from export_room(objects, run, scene.fipt.parts.engine_source, scene.fipt.capture.completed)
    return warnings


def apply_steps(run: RunFolder, settings: Settings) -> list[Step]:
    """Texture coordinates, baking, assignment; the first two are kept while their inputs are the same.

    After the job comes `applied`.

    Args:
        run: the scene's run folder.
        settings: of the textures.
    """
    import bpy

    def objects() -> list[bpy.types.Object]:  # undo may replace them and the scene
        return bpy.context.scene.fipt.capture.room_objects(bpy.context.scene)

    def lay_out() -> Slices[None]:
        from ..blend.room.atlas import make_atlas

        read = [getattr(settings, name) for name in _ATLAS_SETTINGS]
        paths = [
            run.room_npz,
            run.scan_npz,
            run.resolution_npz,
            *([run.parts_npz] if settings.atlas_images == "part" else []),
        ]
        made = Made(run, "atlas", read, content_digest(*paths), outputs=[run.atlas_npz, run.atlas_json])
        if made.kept() is None:
            with made.making():
                yield from make_atlas(objects(), run, settings)

    def build() -> Slices[list[Message]]:
        from ..blend.lights.world import apply_environment
        from ..blend.results.applying import apply_results
        from ..blend.texture_files import texture_files

        files = texture_files(bpy.context.scene, run)
        warnings = yield from apply_results(run, objects(), bpy.context.scene, files)
        if apply_environment(run, bpy.context.scene, files) is None:
            warnings.append(warning("world-kept"))
        return warnings

    return [
        Step(
            "apply-atlas",
            "Creating texture coordinates",
            2.0,
            function=lay_out,
            expected=lambda: atlas_seconds(run),
        ),
        Step(
            "apply-textures",
            "Baking textures",
            25.0,
            command=["textures", str(run.root)],
            expected=lambda: texture_seconds(run, settings),
        ),
        Step("apply-build", "Building materials and lights", 1.0, function=build),
    ]


def applied(scene: bpy.types.Scene, run: RunFolder) -> None:
    """After `apply_steps`: bring the panel and the rest of the scene up to date."""
    from ..blend.marks import ADDED, FOUND
    from ..blend.results.scene_state import finish

    finish(scene, run)
    settings = scene.fipt.capture
    # What the artist deletes of it stays away in the next estimation. Closed holes alone say nothing of the
    # search, which may find more with other masks.
    settings.completed |= any(item.get(ADDED) == FOUND for item in settings.room_objects(scene))
