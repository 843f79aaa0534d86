# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one job that runs, advanced by a timer in a window or to its end in background; what panels show of it.

It holds names, never Blender's objects, so that it outlives undo and the loading of files.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from . import preferences, previews, runstate
from .core.job.errors import FiptError
from .core.job.runfolder import RunFolder

if TYPE_CHECKING:
    from .bridge.process import Message
    from .bridge.sequence import Job

_WORK_SECONDS = 0.01  # between slices of work on Blender's data
_WATCH_SECONDS = 0.1  # between looks at the engine
# What an engine is about that was found working: title and kind by its command.
_TITLES = {
    "estimate": ("Estimate", "estimate"),
    "textures": ("Bake Textures", "materials"),
    "report": ("Report", "check"),
    "ingest": ("Import", "capture"),
}


@dataclass
class RunningJob:
    """What there is to know of a job, while it runs and after it.

    Attributes:
        title: what the user reads, e.g. "Estimate".
        kind: which section started it, e.g. "estimate".
        scene_name: the scene on whose data it works; "" for none.
        run_folder: where its engine works.
        state: "running", "finished", "failed" or "cancelled".
        stopping: whether it was told to stop and has not stopped yet.
        stage_text: what is being done now.
        fraction: done share of the whole job, 0 to 1.
        remaining_seconds: expected time to the end; None while unknown.
        memory_gb: the engine's peak memory.
        warnings: warning messages (code, text, remedy), oldest first.
        error: the error message that ended it, or None.
        pictures: newest preview images, base colour and emission of a view.
    """

    title: str
    kind: str
    scene_name: str
    run_folder: Path
    state: str = "running"
    stopping: bool = False
    stage_text: str = ""
    fraction: float = 0.0
    remaining_seconds: float | None = None
    memory_gb: float = 0.0
    warnings: list[Message] = field(default_factory=list)
    error: Message | None = None
    pictures: list[Path] = field(default_factory=list)


@dataclass
class _Active:
    info: RunningJob
    job: Job
    on_end: Callable[[RunningJob], None] | None
    blend_file: str
    scene_uid: int


_active: _Active | None = None
_last: dict[str | None, RunningJob] = {}
_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def register() -> None:
    """Let ESC stop the running job.

    An entry of the key map and no modal operator: while one of those runs, Blender does not save
    automatically, and a run may take an hour. In background there is no key map.
    """
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:
        keymap = configuration.keymaps.new(name="Window", space_type="EMPTY")
        _keymap_items.append((keymap, keymap.keymap_items.new("fipt.cancel", "ESC", "PRESS")))
    runstate.register(_after_look)


def unregister() -> None:
    """End the running job, or let its engine go on alone if the preferences say so; leave nothing behind."""
    if _active is not None:
        if preferences.get_preferences().on_close == "KEEP":
            _active.job.leave()
        else:
            _active.job.cancel()
        _end()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    while _keymap_items:
        keymap, item = _keymap_items.pop()
        keymap.keymap_items.remove(item)
    _last.clear()
    runstate.unregister()
    previews.clear()


def current() -> RunningJob | None:
    """The job that runs now."""
    return None if _active is None else _active.info


def last(kind: str | None = None) -> RunningJob | None:
    """The job that ended last, of one kind or of any."""
    return _last.get(kind)


def start(
    job: Job,
    *,
    title: str,
    kind: str,
    scene_name: str,
    run_folder: Path,
    on_end: Callable[[RunningJob], None] | None = None,
) -> RunningJob:
    """Let a job run beside the user's work; a timer advances it (in a window; in background call `tick`).

    Args:
        job: not begun yet.
        title, kind, scene_name, run_folder: see `RunningJob`.
        on_end: called once at the end, whatever it is; a FiptError of it makes the job a failed one.

    Raises:
        FiptError: ``job-running`` where another one runs.
    """
    global _active
    if _active is not None:
        raise FiptError(
            "job-running",
            f"'{_active.info.title}' is still running.",
            "Wait for its end, or cancel it first.",
        )
    info = RunningJob(title, kind, scene_name, Path(run_folder))
    job.around = lambda: _scene_context(info)
    scene = find_scene(scene_name, run_folder) if scene_name else None
    _active = _Active(info, job, on_end, bpy.data.filepath, scene.session_uid if scene else 0)
    runstate.forget(run_folder)
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, persistent=True)
    redraw()
    return info


def refuse(error: FiptError, *, title: str, kind: str, scene_name: str, run_folder: Path) -> None:
    """Note why a job did not even start, for the panel: as the last one of its kind, failed."""
    info = RunningJob(title, kind, scene_name, Path(run_folder), state="failed", error=_as_message(error))
    _last[kind] = _last[None] = info
    redraw()


def run(
    job: Job,
    *,
    title: str,
    kind: str,
    scene_name: str,
    run_folder: Path,
    on_end: Callable[[RunningJob], None] | None = None,
) -> RunningJob:
    """The same, but wait for the end; an exception in between, Ctrl-C among them, cancels the job."""
    info = start(job, title=title, kind=kind, scene_name=scene_name, run_folder=run_folder, on_end=on_end)
    try:
        job.run(lambda message: _note(info, message))
    finally:
        _end()
    return info


def cancel() -> None:
    """Tell the running job to stop; it has stopped within two seconds. What it has finished stays."""
    if _active is None:
        return
    _active.job.request_cancel()
    _active.info.stopping = True
    if _active.job.finished:
        _end()
    redraw()


def tick() -> float | None:
    """Advance the job; returns the seconds until the next call is due, None when there is nothing to do."""
    if _active is None:
        return None
    info, job = _active.info, _active.job
    _keep_folder(_active)
    try:
        messages = job.advance()
    except Exception as error:  # nobody stands above a timer
        _print_traceback()
        job.cancel()
        job.error = _unexpected(error)
        messages = []
    before = _shown(info)
    for message in messages:
        _note(info, message)
    if job.finished:
        _end()
        return None
    if _shown(info) != before:
        redraw()
    return _WATCH_SECONDS if job.waits and not info.stopping else _WORK_SECONDS


def _shown(info: RunningJob) -> tuple[object, ...]:
    """What a panel can tell apart: the engine says how far it is several times a second."""
    remaining = info.remaining_seconds
    left = None if remaining is None else int(remaining) if remaining < 60.0 else int(remaining / 60.0) * 60
    facts = (round(info.fraction, 2), left, round(info.memory_gb, 1), len(info.warnings))
    return (info.stage_text, info.stopping, *facts, *info.pictures)


def _keep_folder(active: _Active) -> None:
    """Tell the job's scene its run folder again, which an undo or the file on disk may not know."""
    if not active.scene_uid or find_scene(active.info.scene_name, active.info.run_folder) is not None:
        return
    for scene in bpy.data.scenes:
        same_file = active.blend_file and bpy.data.filepath == active.blend_file
        same = scene.session_uid == active.scene_uid or (same_file and scene.name == active.info.scene_name)
        if same and not scene.fipt.run_folder:
            scene.fipt.run_folder = str(active.info.run_folder)


def attach(scene: bpy.types.Scene) -> bool:
    """Watch the engine that works in a scene's run folder already, if any; the panel then shows its progress.

    Raises:
        FiptError: ``job-running``; those of `RunFolder.read`.
    """
    from .bridge.process import find_engine
    from .mainjob import estimate_step
    from .runjob import attach_job

    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    job = attach_job(run, [estimate_step(run, run.read())])
    if job is None:
        return False
    found = find_engine(run)
    title, kind = _TITLES.get(found.command[0] if found else "estimate", ("Engine", "estimate"))
    start(job, title=title, kind=kind, scene_name=scene.name, run_folder=run.root)
    return True


def _after_look(folder: Path, state: runstate.RunState, changed: bool) -> None:
    """Draw what is new in a run folder, and watch the engine that works there without a Blender."""
    if changed:
        if _active is None:
            previews.load(state.pictures)
        redraw()
    if state.engine and _active is None:
        for scene in bpy.data.scenes:
            if names_folder(scene, folder):
                with suppress(FiptError):
                    attach(scene)
                return


def push_undo(text: str) -> None:
    """Make an undo step of what a timer has done to Blender's data."""
    windows = bpy.context.window_manager.windows
    if windows:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.ed.undo_push(message=text)


def find_scene(scene_name: str, run_folder: Path) -> bpy.types.Scene | None:
    """The scene on which a job works, looked up afresh: one that names the job's run folder."""
    scenes = [scene for scene in bpy.data.scenes if names_folder(scene, run_folder)]
    scenes.sort(key=lambda scene: scene.name != scene_name)
    return scenes[0] if scenes else None


def concerns(scene: bpy.types.Scene, job: RunningJob) -> bool:
    """Whether a job that has ended was this scene's: of its run folder, or refused before there was one."""
    if scene.fipt.run_folder:
        return names_folder(scene, job.run_folder)
    return job.error is not None and scene.name == job.scene_name


def names_folder(scene: bpy.types.Scene, run_folder: Path) -> bool:
    """Whether a scene's results lie in that run folder."""
    path = scene.fipt.run_folder
    return bool(path) and _normal(bpy.path.abspath(path)) == _normal(str(run_folder))


def _normal(path: str) -> str:
    return os.path.normcase(os.path.abspath(path))


@contextmanager
def _scene_context(info: RunningJob) -> Iterator[None]:
    """The context in which a job works on Blender's data: its own scene, whichever the window shows."""
    if not info.scene_name:
        yield
        return
    scene = find_scene(info.scene_name, info.run_folder)
    if scene is None:
        raise FiptError(
            "scene-gone",
            f"The scene '{info.scene_name}' of this job is not open any more.",
            "Open its file again and resume.",
        )
    windows = bpy.context.window_manager.windows
    fitting = [window for window in windows if window.scene == scene] or list(windows)
    override: dict[str, Any] = {"scene": scene}
    if fitting:
        override["window"] = fitting[0]
    if not fitting or fitting[0].scene != scene:
        override["view_layer"] = scene.view_layers[0]
    with bpy.context.temp_override(**override):
        yield


def _note(info: RunningJob, message: Message) -> None:
    kind = message["type"]
    if kind == "stage":
        info.stage_text = message["text"]
    elif kind == "progress":
        info.fraction = message["fraction"]
        info.remaining_seconds = message.get("remaining_seconds")
        info.memory_gb = message.get("memory_gb") or 0.0
        if message.get("files"):
            info.pictures = [info.run_folder / name for name in message["files"]]
            previews.load(info.pictures)
    elif kind == "warning":
        info.warnings.append(message)


def _end() -> None:
    global _active
    assert _active is not None
    active, _active = _active, None
    info, job = active.info, active.job
    info.stopping = False
    info.error = job.error
    info.state = "failed" if job.error else "cancelled" if job.cancelled else "finished"
    _last[info.kind] = _last[None] = info
    if active.on_end is not None:
        try:
            active.on_end(info)
        except FiptError as error:
            info.error = _as_message(error)
            info.state = "failed"
        except Exception as error:
            _print_traceback()
            info.error = _unexpected(error)
            info.state = "failed"
    runstate.forget(info.run_folder)
    redraw()


def _as_message(error: FiptError) -> Message:
    return {"type": "error", "code": error.code, "text": error.text, "remedy": error.remedy}


def _print_traceback() -> None:
    import traceback

    traceback.print_exc()


def _unexpected(error: Exception) -> Message:
    return {
        "type": "error",
        "code": "blender-step-failed",
        "text": f"Something unforeseen happened: {type(error).__name__}: {error}",
        "remedy": "Resume; if it happens again, please report it with what the console says.",
    }


def redraw() -> None:
    """Draw the sidebars anew in which jobs are shown."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PREFERENCES"):
                for region in area.regions:
                    if region.type in ("UI", "WINDOW") and (area.type, region.type) != ("VIEW_3D", "WINDOW"):
                        region.tag_redraw()
