"""Final pictures: Blender's own render, as by F12, of what the camera sees or of a scene over its photograph.

In a window Blender renders beside the artist's work, and shows the first samples and its own progress.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy

from ...core.run.errors import FiptError
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder
from ..capture.importing import room_missing
from ..changed import changed
from ..marks import VIEW
from .cycles import render, render_failed, save_render
from .editors import load_picture, open_editor
from .image_files import LAYERED_IMAGE, PNG, STILL_IMAGE
from .plate import plate_scene, remove_plate_scene
from .renders import list_render, picture_path

_LOOKS = 0.5  # seconds between looks at Blender's render


@dataclass(frozen=True)
class _Picture:
    """A picture, by the names of its scene and of the one that is rendered: undo invalidates pointers."""

    scene: str
    shot: str
    path: Path
    run: RunFolder
    kind: str
    view: str


def take_picture(scene: bpy.types.Scene, run: RunFolder, failed: Callable[[FiptError], None]) -> None:
    """Render what a scene's camera sees to an EXR of all layers and passes and a PNG, and show it.

    Args:
        scene: with a camera; its backdrop decides what is behind the objects.
        run: its run folder.
        failed: told of what goes wrong after the render in a window; in background it is raised.
    """
    if not scene.fipt.capture.room_objects(scene):
        raise room_missing()
    plate, camera = scene.fipt.insert.backdrop == "PHOTOGRAPH", scene.camera
    shot = view_scene(scene, run) if plate else scene
    kind, name = "composite" if plate else "insert", str(camera.get(VIEW, camera.name))
    path = picture_path(run, kind, name + ("_photograph" if plate else ""))
    picture = _Picture(scene.name, shot.name, path, run, kind, name)
    if bpy.app.background:
        try:
            render(shot)
            _keep(picture)
        finally:
            _clear(picture)
        return
    ended: list[object] = []
    note = partial(_note, ended)
    # A window shows the render of its own scene alone; a picture over a photograph is shown at its end.
    shown = {"render_display_type": "NONE"} if plate else {}
    bpy.app.handlers.render_complete.append(note)
    with changed(bpy.context.preferences.view, shown):
        started = bpy.ops.render.render("INVOKE_DEFAULT", scene=shot.name)
    if "RUNNING_MODAL" not in started:
        bpy.app.handlers.render_complete.remove(note)
        _clear(picture)
        raise render_failed("it renders something else, or the scene can't be rendered")
    bpy.app.timers.register(partial(_watch, picture, note, ended, failed), first_interval=_LOOKS)


def view_scene(scene: bpy.types.Scene, run: RunFolder) -> bpy.types.Scene:
    """`plate_scene` of the view that the scene's camera shows."""
    if not scene.camera or not scene.camera.get(VIEW):
        raise FiptError("view-missing.view-scene")
    return plate_scene(scene, run, read_capture(run.capture_json).view(str(scene.camera[VIEW])))


def _note(ended: list[object], *_: object) -> None:
    """Blender calls this in the thread that renders, where no data may be changed."""
    ended.append(True)


def _watch(
    picture: _Picture,
    note: Callable[..., None],
    ended: list[object],
    failed: Callable[[FiptError], None],
) -> float | None:
    """Wait for the end of Blender's render; keep the picture unless the artist has stopped it."""
    if bpy.app.is_job_running("RENDER"):
        return _LOOKS
    bpy.app.handlers.render_complete.remove(note)
    try:
        if ended and {picture.scene, picture.shot} <= set(bpy.data.scenes.keys()):
            _keep(picture)
            image = load_picture(picture.path.with_suffix(".png"))
            if picture.shot != picture.scene and image is not None:
                window = bpy.context.window_manager.windows[0]
                with bpy.context.temp_override(window=window, area=window.screen.areas[0]):
                    open_editor(bpy.context, image)
    except FiptError as error:
        failed(error)
    finally:
        _clear(picture)
    return None


def _keep(picture: _Picture) -> None:
    """Save Blender's render, and list it in renders.json."""
    shot, png = bpy.data.scenes[picture.shot], picture.path.with_suffix(".png")
    save_render(shot, picture.path, LAYERED_IMAGE)
    save_render(shot, png, {**STILL_IMAGE, **PNG})
    list_render(picture.run, picture.kind, picture.view, png)
    bpy.data.scenes[picture.scene].fipt.insert.picture = str(png)


def _clear(picture: _Picture) -> None:
    """Remove the scene that was made for the picture, if any."""
    if picture.shot != picture.scene and picture.shot in bpy.data.scenes:
        remove_plate_scene(bpy.data.scenes[picture.shot])
