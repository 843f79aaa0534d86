# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on does between jobs: Esc stops the running one, an engine found at work is attached, the
results of an estimation are applied.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend import previews
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from . import running, runstate, saving
from .job_scene import find_scene, scene_context, uses_run_folder
from .window import redraw, show_notice

# Title and kind of the job by the command of an engine that is found at work.
_TITLES = {
    "estimate": ("Estimate", "estimate"),
    "textures": ("Bake Textures", "materials"),
    "report": ("Report", "check"),
    "ingest": ("Import", "capture"),
}

# Esc that stops playback is passed on to the other key maps, and arrives when nothing plays any more.
_SAME_KEY_SECONDS = 0.5

_playback_ended = -_SAME_KEY_SECONDS  # in seconds of `time.monotonic`
_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def register() -> None:
    """Add the shortcut Esc and listen to what the run folders' timer finds.

    A key map item instead of a modal operator: Blender does not auto-save while one runs, and a run may take
    an hour. Background mode has no key map.
    """
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:
        keymap = configuration.keymaps.new(name="Window", space_type="EMPTY")
        item = keymap.keymap_items.new("fipt.cancel", "ESC", "PRESS")
        item.properties.by_key = True
        _keymap_items.append((keymap, item))
    bpy.app.handlers.animation_playback_post.append(_note_playback_end)
    runstate.register(_after_look)
    running.register(after_job)
    saving.register()


def unregister() -> None:
    """End the running job, remove the shortcut, the timers and the icons."""
    running.shut_down()
    while _keymap_items:
        keymap, item = _keymap_items.pop()
        keymap.keymap_items.remove(item)
    bpy.app.handlers.animation_playback_post.remove(_note_playback_end)
    runstate.unregister()
    saving.unregister()
    previews.clear()


@bpy.app.handlers.persistent
def _note_playback_end(*_: object) -> None:
    global _playback_ended
    _playback_ended = time.monotonic()


def stops_playback(screen: bpy.types.Screen | None) -> bool:
    """Whether a key that was just pressed stops the playback of an animation."""
    playing = screen is not None and screen.is_animation_playing
    return playing or time.monotonic() - _playback_ended < _SAME_KEY_SECONDS


def attach(scene: bpy.types.Scene) -> bool:
    """Watch the engine that is at work in a scene's run folder; returns whether there is one.

    Raises:
        FiptError: ``job-running``; those of `RunFolder.read`.
    """
    from ..bridge.attached import find_engine
    from .run_job import attach_job
    from .scene_steps import estimate_step

    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    job = attach_job(run, [estimate_step(run, run.read())])
    if job is None:
        return False
    engine = find_engine(run)
    title, kind = _TITLES.get(engine.command[0] if engine else "estimate", ("Engine", "estimate"))
    info = running.RunningJob(title, kind, scene.name, run.root)
    with suppress(OSError):  # written when the engine started
        info.started -= max(time.time() - run.engine_lock.stat().st_mtime, 0.0)
    running.start(job, info)
    return True


def after_job(info: running.RunningJob) -> None:
    """What follows a job: photographs without cameras become a capture; results of an estimation are applied,
    unless the artist does not want that or is in Edit Mode.
    """
    title, _ = _TITLES["estimate"]  # other jobs of that kind apply their results themselves
    scene = find_scene(info.scene_name, info.run_folder)
    if info.error is not None and info.error["code"] == "cameras-missing" and scene is not None:
        with scene_context(scene.name, info.run_folder):
            if bpy.ops.fipt.photographs_of_capture.poll():
                bpy.ops.fipt.photographs_of_capture("INVOKE_DEFAULT")
                show_notice(iface_("These are photographs without cameras, which come next"), "INFO")
        return
    if info.title != title or info.state != "finished" or scene is None:
        return
    if scene.fipt.estimate.apply_when_finished:
        with scene_context(scene.name, info.run_folder):
            if bpy.ops.fipt.apply_results.poll():
                bpy.ops.fipt.apply_results("INVOKE_DEFAULT")


def _after_look(folder: Path, state: runstate.RunState, changed: bool) -> None:
    """Show what changed in a run folder, and attach an engine that works there unwatched."""
    idle = running.current() is None
    if changed:
        if idle:
            previews.estimate_pictures.load(state.pictures)
        redraw()
    if state.engine and idle:
        for scene in bpy.data.scenes:
            if uses_run_folder(scene, folder):
                with suppress(FiptError):
                    attach(scene)
                return
