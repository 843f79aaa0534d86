"""What the add-on does between jobs: Esc stops the running one, the results of an estimation are applied."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..blend import previews
from . import files, running, runstate
from .job_scene import find_scene, scene_context
from .window import open_sidebar, redraw, show_notice, shows_light

if TYPE_CHECKING:
    from ..bridge.job import Job

# Esc that stops playback is passed on to the other key maps, and arrives when nothing plays any more.
_SAME_KEY_SECONDS = 0.5

_playback_ended = -_SAME_KEY_SECONDS  # in seconds of `time.monotonic`
_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def register() -> None:
    """Add the shortcuts Esc and Ctrl Q and listen to what the run folders' timer finds.

    A key map item instead of a modal operator: Blender does not auto-save while one runs, and a run may take
    an hour. Background mode has no key map.
    """
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:
        keymap = configuration.keymaps.new(name="Window", space_type="EMPTY")
        item = keymap.keymap_items.new("fipt.cancel", "ESC", "PRESS")
        item.properties.by_key = True
        _keymap_items.append((keymap, item))
        command = "oskey" if sys.platform == "darwin" else "ctrl"
        item = keymap.keymap_items.new("fipt.quit_during_job", "Q", "PRESS", **{command: True})
        _keymap_items.append((keymap, item))
    bpy.app.handlers.animation_playback_post.append(_note_playback_end)
    runstate.on_change = _show_state
    running.register(after_job)
    if not bpy.app.background:
        bpy.app.timers.register(_tell_where, first_interval=1.0)
    files.register()


def unregister() -> None:
    """End the running job, remove the shortcuts, the timers and the icons."""
    running.shut_down()
    if bpy.app.timers.is_registered(_tell_where):
        bpy.app.timers.unregister(_tell_where)
    while _keymap_items:
        keymap, item = _keymap_items.pop()
        keymap.keymap_items.remove(item)
    bpy.app.handlers.animation_playback_post.remove(_note_playback_end)
    runstate.unregister()
    files.unregister()
    previews.clear()


def _tell_where() -> None:
    """After the installation nothing else says where the add-on is."""
    if not machine.has_engine():
        show_notice(iface_("FIPT is in the sidebar of the 3D Viewport: press N there, tab FIPT"), "INFO")


@bpy.app.handlers.persistent
def _note_playback_end(*_: object) -> None:
    global _playback_ended
    _playback_ended = time.monotonic()


def stops_playback(screen: bpy.types.Screen | None) -> bool:
    """Whether a key that was just pressed stops the playback of an animation."""
    playing = screen is not None and screen.is_animation_playing
    return playing or time.monotonic() - _playback_ended < _SAME_KEY_SECONDS


def after_job(info: Job) -> None:
    """What follows a job: photographs without cameras become a capture; results of an estimation are applied,
    unless the artist does not want that or is in Edit Mode.
    """
    scene = find_scene(info.scene_name, info.run_folder)
    applied = info.kind == "materials" or info.title == "Example"
    if applied and info.state == "finished" and shows_light():
        text = iface_("{}: finished. The view is gray until Cycles has loaded the room")
        show_notice(text.format(iface_(info.title)), "INFO")
    if info.title == "Import Capture" and info.error is None:  # dropped on the window, or from File > Import
        open_sidebar()
    if info.error is not None and info.error["code"] == "cameras-missing" and scene is not None:
        with scene_context(scene.name, info.run_folder):
            if bpy.ops.fipt.photographs_of_capture.poll():
                bpy.ops.fipt.photographs_of_capture("INVOKE_DEFAULT")
                show_notice(iface_("These are photographs without cameras, which come next"), "INFO")
        return
    # Other jobs of the kind "estimate" apply their results themselves.
    if info.title != "Estimate" or info.state != "finished" or scene is None:
        return
    if scene.fipt.estimate.apply_when_finished:
        with scene_context(scene.name, info.run_folder):
            if bpy.ops.fipt.apply_results.poll():
                bpy.ops.fipt.apply_results("INVOKE_DEFAULT")


def _show_state(state: runstate.RunState) -> None:
    """Show what changed in a run folder."""
    if running.current() is None:
        previews.estimate_pictures.load((*state.pictures, *state.worst))
    redraw()
