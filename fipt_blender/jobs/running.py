"""The running job, at most one: advanced by a timer in a window, run to its end in background mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend import previews
from ..core.run.errors import FiptError, as_message, problem
from . import runstate
from .job_scene import find_scene, scene_context, uses_run_folder
from .window import push_undo, redraw, show_notice

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..bridge.process import Message

DATA_KIND = "environment"  # kind of the jobs on the data folder
_WORK_SECONDS = 0.01  # between slices of work on Blender's data


@dataclass
class _Active:
    job: Job
    on_end: Callable[[Job], None] | None
    blend_file: str
    scene_uid: int
    content: int = 0  # of `_content`, before an undo
    undone: bool = False  # whether an undo took some of that away


_active: _Active | None = None
_last: dict[str | None, Job] = {}
# Called after the end of each job that a window's timer has advanced.
_listeners: list[Callable[[Job], None]] = []


def register(after_end: Callable[[Job], None]) -> None:
    """Add a function that is called after each job in a window, which may start the next one; watch undo."""
    if _before_undo not in bpy.app.handlers.undo_pre:
        bpy.app.handlers.undo_pre.append(_before_undo)
        bpy.app.handlers.undo_post.append(_after_undo)
    _listeners.append(after_end)


def current() -> Job | None:
    """The job that runs now."""
    return None if _active is None else _active.job


def other_file() -> str:
    """Name of the file whose job runs, where another one is open now; "" where it is the same or has none."""
    if _active is None or _active.blend_file == bpy.data.filepath:
        return ""
    return bpy.path.basename(_active.blend_file)


def last(kind: str | None = None) -> Job | None:
    """The job that ended last, of one kind or of any."""
    return _last.get(kind)


def start(job: Job, on_end: Callable[[Job], None] | None = None) -> Job:
    """Run a job in the background of the window, advanced by a timer; without a window, call `tick`.

    Args:
        job: not begun yet.
        on_end: called once at the end, however it ends; a FiptError that it raises fails the job.

    Returns:
        `job`.
    """
    global _active
    if _active is not None:
        raise FiptError("job-running.start", title=_active.job.title)
    job.around = lambda: scene_context(job.scene_name, job.run_folder)
    scene = find_scene(job.scene_name, job.run_folder) if job.scene_name else None
    _active = _Active(job, on_end, bpy.data.filepath, scene.session_uid if scene else 0)
    runstate.forget(job.run_folder)
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, persistent=True)
    redraw()
    return job


def run(job: Job, on_end: Callable[[Job], None] | None = None) -> Job:
    """As `start`, but wait for the end; an exception meanwhile, such as Ctrl-C, cancels the job."""
    start(job, on_end)
    try:
        job.run()
    finally:
        _end()
    return job


def refuse(job: Job, error: FiptError) -> None:
    """Record a job that could not start as the last one of its kind, so that the panel shows why."""

    job.ended, job.error = True, as_message("error", error)
    _last[job.kind] = _last[None] = job
    redraw()


def settle(kind: str, code: str) -> None:
    """Drop a warning or the error of the last job of a kind, once its remedy was followed."""
    job = _last.get(kind)
    if job is None:
        return
    job.warnings[:] = [message for message in job.warnings if message["code"] != code]
    if job.error is not None and job.error["code"] == code:
        del _last[kind]


def cancel() -> None:
    """Ask the running job to stop, which takes at most two seconds. Finished steps are kept."""
    if _active is None:
        return
    _active.job.request_cancel()
    if _active.job.ended:
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
    job = _active.job
    if is_saved():
        push_undo(job.title)  # so that Blender asks before it quits, which would end the job
    if _active.undone:
        _redo(_active)
    _keep_run_folder(_active)
    shown, pictures = _shown(job), job.pictures
    try:
        job.advance()
    except Exception as error:  # a timer has no caller that could report it
        job.cancel()
        job.error = _unexpected(error)
    if job.pictures != pictures:
        previews.estimate_pictures.load(job.pictures)
    if job.ended:
        _end()
        for listener in _listeners:
            listener(job)
        return None if _active is None else _WORK_SECONDS  # a listener may have started the next job
    if _shown(job) != shown:
        redraw()
    return 0.1 if job.waits and not job.stopping else _WORK_SECONDS  # between looks at the engine


def count_text(count: int) -> str:
    """How many warnings there are, in words."""
    return iface_("1 warning") if count == 1 else iface_("{} warnings").format(count)


def belongs_to(job: Job, scene: bpy.types.Scene) -> bool:
    """Whether an ended job was this scene's: on its run folder, or refused before it had one."""
    if scene.fipt.run_folder:
        return uses_run_folder(scene, job.run_folder)
    return job.error is not None and scene.name == job.scene_name


def _shown(job: Job) -> tuple[object, ...]:
    """The values as precisely as panels show them: the engine reports progress several times a second."""
    remaining = job.remaining_seconds
    left = None if remaining is None else int(remaining) if remaining < 60.0 else int(remaining / 60.0) * 60
    passed = int(job.worked_seconds / 60.0)
    numbers = (round(job.fraction, 2), left, passed, round(job.memory_gb, 1), len(job.warnings))
    return (job.stage_text, job.stopping, *numbers, *job.pictures)


def is_saved() -> bool:
    """Whether the file has no unsaved changes. A window knows it soon after handlers of saving have run."""
    return not bpy.data.is_dirty


def _keep_run_folder(active: _Active) -> None:
    """Set the run folder again in the job's scene where undo or reloading the file took it back."""
    if not active.scene_uid or find_scene(active.job.scene_name, active.job.run_folder) is not None:
        return
    for scene in bpy.data.scenes:
        same_file = active.blend_file and bpy.data.filepath == active.blend_file
        same = scene.session_uid == active.scene_uid or (same_file and scene.name == active.job.scene_name)
        if same and not scene.fipt.run_folder:
            scene.fipt.run_folder = str(active.job.run_folder)


def _content(job: Job) -> int:
    """How much of what the job works on is in the open file: its scene, the views, the room's meshes."""
    scene = find_scene(job.scene_name, job.run_folder) if job.scene_name else None
    if scene is None:
        return 0
    capture = scene.fipt.capture
    return 1 + bool(capture.views) + bool(capture.room_objects(scene))


@bpy.app.handlers.persistent
def _before_undo(*_: object) -> None:
    if _active is not None and not _active.undone:
        _active.content = _content(_active.job)


@bpy.app.handlers.persistent
def _after_undo(*_: object) -> None:
    if _active is not None:
        _active.undone = _content(_active.job) < _active.content


def _redo(active: _Active) -> None:
    """Bring back what the job works on, where undo took it away; other steps can be undone meanwhile."""
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(**({"window": windows[0]} if windows else {})):
        while _content(active.job) < active.content and bpy.ops.ed.redo.poll():
            bpy.ops.ed.redo()
    active.undone = False
    text = iface_("{} works on what Undo would take away. Stop it with Esc first")
    show_notice(text.format(iface_(active.job.title)), "WARNING")


def _end() -> None:
    global _active

    assert _active is not None
    active, _active = _active, None
    job = active.job
    _last[job.kind] = _last[None] = job
    if active.on_end is not None:
        try:
            active.on_end(job)
        except FiptError as error:
            job.error = as_message("error", error)
        except Exception as error:
            job.error = _unexpected(error)
    runstate.forget(job.run_folder)
    redraw()
    if job.error is not None:
        # No popup: the job's section shows the error with what helps.
        show_notice(iface_("{} failed: {}").format(iface_(job.title), job.error["text"]), "WARNING")
    elif job.state == "finished":
        text = iface_("{}: finished").format(iface_(job.title))
        show_notice(f"{text}, {count_text(len(job.warnings))}" if job.warnings else text, "INFO")


def _unexpected(error: Exception) -> Message:
    """The message for an exception that is being handled; its traceback is printed."""
    import traceback

    traceback.print_exc()
    said = problem("blender-step-failed.unexpected", kind=type(error).__name__, error=error)
    return as_message("error", said)
