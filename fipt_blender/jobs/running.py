# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The running job, at most one: advanced by a timer in a window, run to its end in background mode.

It is kept by names, without references to Blender's objects, so it survives undo and the loading of files.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend import previews
from ..core.run.errors import FiptError
from . import runstate
from .job_scene import find_scene, scene_context, uses_run_folder
from .window import push_undo, redraw, show_notice

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job

DATA_KIND = "environment"  # kind of the jobs on the data folder
_WORK_SECONDS = 0.01  # between slices of work on Blender's data


@dataclass
class RunningJob:
    """What panels show of a job, while it runs and after its end.

    Attributes:
        title: name for the user, e.g. "Estimate".
        kind: section that started it, e.g. "estimate".
        scene_name: scene whose data it works on; "" for none.
        run_folder: where its engine works.
        started: when its work began, in seconds of `time.monotonic`.
        state: "running", "finished", "failed" or "cancelled".
        stopping: whether it was asked to stop and still runs.
        stage_text: text of the current stage.
        fraction: finished share of the whole job, 0 to 1.
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
    started: float = field(default_factory=time.monotonic)
    state: str = "running"
    stopping: bool = False
    stage_text: str = ""
    fraction: float = 0.0
    remaining_seconds: float | None = None
    memory_gb: float = 0.0
    warnings: list[Message] = field(default_factory=list)
    error: Message | None = None
    pictures: list[Path] = field(default_factory=list)

    @property
    def worked_seconds(self) -> float:
        """Time since its work began."""
        return time.monotonic() - self.started


@dataclass
class _Active:
    info: RunningJob
    job: Job
    on_end: Callable[[RunningJob], None] | None
    blend_file: str
    scene_uid: int
    content: int = 0  # of `_content`, before an undo
    undone: bool = False  # whether an undo took some of that away


_active: _Active | None = None
_last: dict[str | None, RunningJob] = {}
# Called after the end of each job that a window's timer has advanced.
_listeners: list[Callable[[RunningJob], None]] = []


def register(after_end: Callable[[RunningJob], None]) -> None:
    """Add a function that is called after each job in a window, which may start the next one; watch undo."""
    if _before_undo not in bpy.app.handlers.undo_pre:
        bpy.app.handlers.undo_pre.append(_before_undo)
        bpy.app.handlers.undo_post.append(_after_undo)
    _listeners.append(after_end)


def current() -> RunningJob | None:
    """The job that runs now."""
    return None if _active is None else _active.info


def last(kind: str | None = None) -> RunningJob | None:
    """The job that ended last, of one kind or of any."""
    return _last.get(kind)


def start(job: Job, info: RunningJob, on_end: Callable[[RunningJob], None] | None = None) -> RunningJob:
    """Run a job in the background of the window, advanced by a timer; without a window, call `tick`.

    Args:
        job: not begun yet.
        info: its title, kind, scene and run folder; kept up to date from now on.
        on_end: called once at the end, however it ends; a FiptError that it raises fails the job.

    Returns:
        `info`.

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
    job.around = lambda: scene_context(info.scene_name, info.run_folder)
    scene = find_scene(info.scene_name, info.run_folder) if info.scene_name else None
    _active = _Active(info, job, on_end, bpy.data.filepath, scene.session_uid if scene else 0)
    runstate.forget(info.run_folder)
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, persistent=True)
    redraw()
    return info


def run(job: Job, info: RunningJob, on_end: Callable[[RunningJob], None] | None = None) -> RunningJob:
    """As `start`, but wait for the end; an exception meanwhile, such as Ctrl-C, cancels the job."""
    start(job, info, on_end)
    try:
        job.run(lambda message: _note(info, message))
    finally:
        _end()
    return info


def refuse(info: RunningJob, error: FiptError) -> None:
    """Record a job that could not start as the last one of its kind, so that the panel shows why."""
    info.state, info.error = "failed", _as_message(error)
    _last[info.kind] = _last[None] = info
    redraw()


def settle(kind: str, code: str) -> None:
    """Drop a warning or the error of the last job of a kind, once its remedy was followed."""
    info = _last.get(kind)
    if info is None:
        return
    info.warnings[:] = [message for message in info.warnings if message["code"] != code]
    if info.error is not None and info.error["code"] == code:
        del _last[kind]


def cancel() -> None:
    """Ask the running job to stop, which takes at most two seconds. Finished steps are kept."""
    if _active is None:
        return
    _active.job.request_cancel()
    _active.info.stopping = True
    if _active.job.finished:
        _end()
    redraw()


def shut_down() -> None:
    """End the running job; forget earlier ones."""
    if _active is not None:
        _active.job.cancel()
        _end()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    forget()
    _listeners.clear()
    if _before_undo in bpy.app.handlers.undo_pre:
        bpy.app.handlers.undo_pre.remove(_before_undo)
        bpy.app.handlers.undo_post.remove(_after_undo)


def forget() -> None:
    """Forget the jobs that have ended, with their errors and warnings."""
    _last.clear()


def tick() -> float | None:
    """Advance the job; returns the seconds until the next call, None when there is nothing to do."""
    if _active is None:
        return None
    info, job = _active.info, _active.job
    if is_saved():
        push_undo(info.title)  # so that Blender asks before it quits, which would end the job
    if _active.undone:
        _redo(_active)
    _keep_run_folder(_active)
    try:
        messages = job.advance()
    except Exception as error:  # a timer has no caller that could report it
        _print_traceback()
        job.cancel()
        job.error = _unexpected(error)
        messages = []
    shown = _shown(info)
    for message in messages:
        _note(info, message)
    if job.finished:
        _end()
        for listener in _listeners:
            listener(info)
        return None if _active is None else _WORK_SECONDS  # a listener may have started the next job
    if _shown(info) != shown:
        redraw()
    return 0.1 if job.waits and not info.stopping else _WORK_SECONDS  # between looks at the engine


def count_text(count: int) -> str:
    """How many warnings there are, in words."""
    return iface_("1 warning") if count == 1 else iface_("{} warnings").format(count)


def belongs_to(info: RunningJob, scene: bpy.types.Scene) -> bool:
    """Whether an ended job was this scene's: on its run folder, or refused before it had one."""
    if scene.fipt.run_folder:
        return uses_run_folder(scene, info.run_folder)
    return info.error is not None and scene.name == info.scene_name


def _shown(info: RunningJob) -> tuple[object, ...]:
    """The values as precisely as panels show them: the engine reports progress several times a second."""
    remaining = info.remaining_seconds
    left = None if remaining is None else int(remaining) if remaining < 60.0 else int(remaining / 60.0) * 60
    numbers = (round(info.fraction, 2), left, round(info.memory_gb, 1), len(info.warnings))
    return (info.stage_text, info.stopping, *numbers, *info.pictures)


def is_saved() -> bool:
    """Whether the file has no unsaved changes. A window knows it soon after handlers of saving have run."""
    return not bpy.data.is_dirty


def _keep_run_folder(active: _Active) -> None:
    """Set the run folder again in the job's scene where undo or reloading the file took it back."""
    if not active.scene_uid or find_scene(active.info.scene_name, active.info.run_folder) is not None:
        return
    for scene in bpy.data.scenes:
        same_file = active.blend_file and bpy.data.filepath == active.blend_file
        same = scene.session_uid == active.scene_uid or (same_file and scene.name == active.info.scene_name)
        if same and not scene.fipt.run_folder:
            scene.fipt.run_folder = str(active.info.run_folder)


def _content(info: RunningJob) -> int:
    """How much of what the job works on is in the open file: its scene, the views, the room's meshes."""
    scene = find_scene(info.scene_name, info.run_folder) if info.scene_name else None
    if scene is None:
        return 0
    capture = scene.fipt.capture
    return 1 + bool(capture.views) + bool(capture.room_objects(scene))


@bpy.app.handlers.persistent
def _before_undo(*_: object) -> None:
    if _active is not None and not _active.undone:
        _active.content = _content(_active.info)


@bpy.app.handlers.persistent
def _after_undo(*_: object) -> None:
    if _active is not None:
        _active.undone = _content(_active.info) < _active.content


def _redo(active: _Active) -> None:
    """Bring back what the job works on, where undo took it away; other steps can be undone meanwhile."""
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(**({"window": windows[0]} if windows else {})):
        while _content(active.info) < active.content and bpy.ops.ed.redo.poll():
            bpy.ops.ed.redo()
    active.undone = False
    text = iface_("{} works on what Undo would take away. Stop it with Esc first")
    show_notice(text.format(iface_(active.info.title)), "WARNING")


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
            previews.estimate_pictures.load(info.pictures)
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
    if info.error is not None:
        # No popup: the job's section shows the error with what helps.
        show_notice(iface_("{} failed: {}").format(iface_(info.title), info.error["text"]), "WARNING")
    elif info.state == "finished":
        text = iface_("{}: finished").format(iface_(info.title))
        show_notice(f"{text}, {count_text(len(info.warnings))}" if info.warnings else text, "INFO")


def _as_message(error: FiptError) -> Message:
    return {"type": "error", "code": error.code, "text": error.text, "remedy": error.remedy}


def _print_traceback() -> None:
    import traceback

    traceback.print_exc()


def _unexpected(error: Exception) -> Message:
    return {
        "type": "error",
        "code": "blender-step-failed",
        "text": f"An unexpected error occurred: {type(error).__name__}: {error}",
        "remedy": "Resume. If it happens again, report it with the console's output.",
    }
