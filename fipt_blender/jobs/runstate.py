# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The contents of a scene's run folder, for panels and polls, which must not read the disk themselves.

While drawing, the answer comes from a cache, which a timer refreshes soon after.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.runfolder import RunFolder

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..core.run.result_contents import Stages
    from ..core.run.versions import Version

_FRESH_SECONDS = 2.0


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
        quality: dB with which photographs that were held back are re-rendered from the results; None where
            these were not judged.
        missing: names of files that pictures of applied results in the open file name and that are not there.
    """

    stages: int = 0
    results: bool = False
    finished: bool = False
    versions: tuple[Version, ...] = ()
    warnings: tuple[Message, ...] = ()
    error: Message | None = None
    pictures: tuple[Path, ...] = ()
    quality: float | None = None
    missing: tuple[str, ...] = ()


# Time of the last look (monotonic seconds) and state, by folder.
_known: dict[str, tuple[float, RunState]] = {}
_wanted: set[str] = set()  # folders that the timer looks at next
# Called by the timer with a state that has changed; `session` sets it.
on_change: Callable[[RunState], None] = lambda state: None  # noqa: E731


def unregister() -> None:
    """Clear the cache, and stop the timer."""
    _known.clear()
    _wanted.clear()
    if bpy.app.timers.is_registered(_look_soon):
        bpy.app.timers.unregister(_look_soon)


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
        quality=None if quality is None else quality.held_back_db,
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
