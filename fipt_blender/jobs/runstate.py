"""The contents of a scene's run folder, for panels and polls, which must not read the disk themselves.

While drawing, the answer comes from a cache, which a timer refreshes soon after.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.runfolder import RunFolder
from .job_scene import uses_run_folder
from .window import redraw

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..core.run.result_contents import QualityNote, Stages
    from ..core.run.versions import Version

_FRESH_SECONDS = 2.0
_UNSAVED_SECONDS = 7 * 86400.0  # for which runs are offered that no saved file knows
_MOST_UNSAVED = 2  # of these


@dataclass(frozen=True)
class RunState:
    """The estimation in a run folder.

    Attributes:
        stages: number of finished stages.
        results: whether the results of an estimation exist.
        finished: whether they are those of the last estimation, which has finished then.
        versions: the estimates of the same capture, the newest first.
        warnings, error: warnings of the last run, and the error that ended it.
        pictures: the newest preview images.
        quality: how well photographs that were held back are re-rendered from the results; None where these
            were not judged.
        worst: pictures of the one that is re-rendered worst.
        missing: names of files that pictures of applied results in the open file name and that are not there.
    """

    stages: int = 0
    results: bool = False
    finished: bool = False
    versions: tuple[Version, ...] = ()
    warnings: tuple[Message, ...] = ()
    error: Message | None = None
    pictures: tuple[Path, ...] = ()
    quality: QualityNote | None = None
    worst: tuple[Path, ...] = ()
    missing: tuple[str, ...] = ()


# Time of the last look (monotonic seconds) and state, by folder.
_known: dict[str, tuple[float, RunState]] = {}
_unsaved: tuple[float, tuple[UnsavedRun, ...]] = (-1e9, ())  # time of the last look, and what was found
_wanted: set[str] = set()  # folders that the timer looks at next
# Called by the timer with a state that has changed; `session` sets it.
on_change: Callable[[RunState], None] = lambda state: None  # noqa: E731


def unregister() -> None:
    """Clear the cache, and stop the timer."""
    _known.clear()
    _wanted.clear()
    for timer in (_look_soon, _look_for_unsaved):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)


def known(folder: str) -> RunState:
    """The state of a run folder ("" for none), in a window from the cache, which may be seconds old."""
    if not folder:
        return RunState()
    folder = os.path.abspath(bpy.path.abspath(folder))
    if bpy.app.background:
        return look(RunFolder(folder))
    looked_at, state = _known.get(folder, (-_FRESH_SECONDS, RunState()))
    if time.monotonic() - looked_at > _FRESH_SECONDS:
        _wanted.add(folder)
        if not bpy.app.timers.is_registered(_look_soon):
            bpy.app.timers.register(_look_soon, first_interval=0.0)
    return state


@dataclass(frozen=True)
class UnsavedRun:
    """A run that no saved file knows, as after a crash.

    Attributes:
        folder: its folder.
        name: of its capture.
        time: of its last change, seconds since 1970.
        stages: number of finished stages.
        finished: whether its estimation has finished.
    """

    folder: Path
    name: str
    time: float
    stages: int
    finished: bool


def unsaved_runs() -> tuple[UnsavedRun, ...]:
    """The newest runs of the data folder that no saved file knows, in a window from the cache."""
    global _unsaved
    if bpy.app.background:
        return _find_unsaved()
    if time.monotonic() - _unsaved[0] > 5.0 * _FRESH_SECONDS:
        _unsaved = time.monotonic(), _unsaved[1]
        bpy.app.timers.register(_look_for_unsaved, first_interval=0.0)
    return _unsaved[1]


def _look_for_unsaved() -> None:
    global _unsaved
    found = _find_unsaved()
    if found != _unsaved[1]:
        _unsaved = time.monotonic(), found
        redraw()


def _find_unsaved() -> tuple[UnsavedRun, ...]:
    from .. import machine
    from ..bridge import storage
    from ..core.run.lock import holder

    found: list[UnsavedRun] = []
    for item in storage.list_items(machine.data_folder()):
        run = RunFolder(item.folder)
        recent = item.kind == storage.RUN and time.time() - item.modified < _UNSAVED_SECONDS
        if not recent or not run.unsaved.is_file() or len(found) == _MOST_UNSAVED:
            continue
        if holder(run) is not None or any(uses_run_folder(scene, run.root) for scene in bpy.data.scenes):
            continue
        state, name = look(run), re.sub(r"-\d{8}-\d{6}(-\d+)?$", "", run.root.name)
        if run.ingest_json.is_file() and state.stages:
            found.append(UnsavedRun(run.root, name, item.modified, state.stages, state.finished))
    return tuple(found)


def forget(folder: Path) -> None:
    """Mark the cached state of a folder as outdated."""
    _, state = _known.pop(os.path.abspath(folder), (0.0, None))
    if state is not None:
        _known[os.path.abspath(folder)] = (-_FRESH_SECONDS, state)


def look(run: RunFolder) -> RunState:
    """Read the state of a run folder from the disk."""
    from ..blend.collecting import missing_pictures
    from ..core.run import versions
    from ..core.run.documents import optional_document
    from ..core.run.result_contents import QualityNote, Stages

    warnings, pictures, error = [], (), None
    for message in _messages(run.messages("estimate")):
        if message["type"] == "warning":
            warnings.append(message)
        elif message["type"] == "error":
            error = message
        elif message.get("files") and message["type"] == "progress":
            pictures = tuple(run.root / name for name in message["files"])
    results = run.statistics_json.exists() and versions.has_results(run)
    stages = optional_document(run.stages_json, Stages)
    quality = optional_document(run.quality_json, QualityNote)
    return RunState(
        stages=0 if stages is None else len(stages.stages),
        results=results,
        finished=results and _of_last_estimation(run, stages),
        versions=tuple(versions.list_versions(run)),
        warnings=tuple(warnings),
        error=error,
        pictures=pictures,
        quality=quality,
        worst=() if quality is None else tuple(run.quality / name for name in quality.worst()),
        missing=tuple(missing_pictures()),
    )


def _look_soon() -> None:
    while _wanted:
        folder = _wanted.pop()
        _, previous = _known.get(folder, (0.0, None))
        state = look(RunFolder(folder))
        _known[folder] = (time.monotonic(), state)
        if state != previous:
            on_change(state)


def _of_last_estimation(run: RunFolder, stages: Stages | None) -> bool:
    """Whether the results come from the last estimation, which has done `stages`."""
    from ..core.run.documents import optional_document
    from ..core.run.result_contents import Stages

    done = optional_document(run.results / run.stages_json.name, Stages)
    if done is None:  # results of an earlier version
        return stages is None or stages.keys.keys() <= stages.stages.keys()
    return stages is not None and stages.keys == done.keys


def _messages(path: Path) -> list[Message]:
    """The messages in a file, without progress messages that have no pictures."""
    from ..core.run.messages import parse_message

    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    lines = [line for line in text.splitlines() if '"type": "progress"' not in line or '"files"' in line]
    return [message for line in lines if (message := parse_message(line)) is not None]
