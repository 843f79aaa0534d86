"""The scene of a job, looked up by run folder and name each time: undo and loading invalidate pointers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..core.run.errors import FiptError


def uses_run_folder(scene: bpy.types.Scene, run_folder: Path) -> bool:
    """Whether this is the scene's run folder."""
    path = scene.fipt.run_folder
    return bool(path) and _normal(bpy.path.abspath(path)) == _normal(str(run_folder))


def _normal(path: str) -> str:
    return os.path.normcase(os.path.abspath(path))


def find_scene(scene_name: str, run_folder: Path) -> bpy.types.Scene | None:
    """The scene that uses a run folder; of several, the one of that name first."""
    scenes = [scene for scene in bpy.data.scenes if uses_run_folder(scene, run_folder)]
    scenes.sort(key=lambda scene: scene.name != scene_name)
    return scenes[0] if scenes else None


@contextmanager
def scene_context(scene_name: str, run_folder: Path) -> Iterator[None]:
    """The context for work on a job's scene, whichever scene the window shows; unchanged for the name ""."""
    if not scene_name:
        yield
        return
    scene = find_scene(scene_name, run_folder)
    if scene is None:
        raise FiptError("scene-gone", scene_name=scene_name)
    windows = list(bpy.context.window_manager.windows)
    window = next((window for window in windows if window.scene == scene), windows[0] if windows else None)
    override: dict[str, object] = {"scene": scene}
    if window is not None:
        override["window"] = window
    if window is None or window.scene != scene:
        override["view_layer"] = scene.view_layers[0]
    with bpy.context.temp_override(**override):
        yield
