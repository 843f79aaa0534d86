"""What buttons and the Python API start on a scene: how a job is made, and what follows its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from . import running
from .job_scene import find_scene
from .window import push_undo

if TYPE_CHECKING:
    from ..bridge.job import Job

Follow = Callable[[bpy.types.Scene, RunFolder], None]


@dataclass(frozen=True)
class Task:
    """Work on a scene and its run folder, or on files in another folder.

    Attributes:
        title: for the user, e.g. "Estimate".
        kind: the section that shows it, e.g. "estimate".
        make: the job, ready to run, on the scene; raises FiptError where it can't start.
        finished: called with the scene after a success; may raise FiptError.
        failed: called after a failure or a cancellation.
        undo: whether its end adds an undo step in a window.
        folder: of work that is not on a scene's data, instead of the scene's run folder.
        ended: called at the end of such work, however it ends; may raise FiptError.
    """

    title: str
    kind: str
    make: Callable[[bpy.types.Scene], Job]
    finished: Follow | None = None
    failed: Follow | None = None
    undo: bool = False
    folder: Path | None = None
    ended: Callable[[Job], None] | None = None


def begin(task: Task, scene: bpy.types.Scene, wait: bool) -> Job:
    """Start a task on the context's scene; with `wait`, run it to its end."""
    from ..bridge.job import Job

    undo = task.title if task.undo and not wait else ""
    # Without `make`: the operator that it may hold is gone by then.
    end = task.ended if task.folder is not None else partial(_end, task.finished, task.failed, undo)
    names = task.title, task.kind, "" if task.folder else scene.name
    try:
        job = task.make(scene)
        job.title, job.kind, job.scene_name = names
        return running.run(job, end) if wait else running.start(job, end)
    except FiptError as error:
        folder = task.folder or Path(bpy.path.abspath(scene.fipt.run_folder))
        job = Job([], folder / "log.txt")
        job.title, job.kind, job.scene_name = names
        running.refuse(job, error)
        raise


def _end(finished: Follow | None, failed: Follow | None, undo: str, job: Job) -> None:
    scene = find_scene(job.scene_name, job.run_folder)
    if scene is None:
        return
    follow = finished if job.state == "finished" else failed
    if follow is not None:
        follow(scene, RunFolder(job.run_folder))
    if job.state == "finished" and undo:
        push_undo(undo)
