# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies in a scene's run folder, for panels and polls, which must not look at the disk themselves.

Asked while drawing, it answers from memory, and has a timer look at the disk soon after.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .core.job.runfolder import RunFolder

if TYPE_CHECKING:
    from .bridge.process import Message

_FRESH_SECONDS = 2.0


@dataclass(frozen=True)
class RunState:
    """The estimation in a run folder.

    Attributes:
        stages: how many stages of it are finished.
        finished: whether its results are there.
        engine: the command of an engine that works there now, or "".
        warnings, error: what its last run warned of, and what ended it.
        pictures: its newest preview images.
    """

    stages: int = 0
    finished: bool = False
    engine: str = ""
    warnings: tuple[Message, ...] = ()
    error: Message | None = None
    pictures: tuple[Path, ...] = ()


# folder -> when it was looked at, and what was there
_known: dict[str, tuple[float, RunState]] = {}
_wanted: set[str] = set()
# What to do after a look at the disk: gets the folder, its state, and whether that is news.
_listeners: list[Callable[[Path, RunState, bool], None]] = []


def register(on_look: Callable[[Path, RunState, bool], None]) -> None:
    """Name who is told after each look at the disk."""
    _listeners.append(on_look)


def unregister() -> None:
    """Forget all, and leave no timer behind."""
    _listeners.clear()
    _known.clear()
    _wanted.clear()
    if bpy.app.timers.is_registered(_look_soon):
        bpy.app.timers.unregister(_look_soon)


def known(folder: str) -> RunState:
    """The state of a run folder ("" for none): for drawing, as it was a moment ago."""
    if not folder:
        return RunState()
    folder = os.path.abspath(bpy.path.abspath(folder))
    if bpy.app.background:
        return look(RunFolder(folder))
    seen, state = _known.get(folder, (-_FRESH_SECONDS, RunState()))
    if time.monotonic() - seen > _FRESH_SECONDS:
        _wanted.add(folder)
        if not bpy.app.timers.is_registered(_look_soon):
            bpy.app.timers.register(_look_soon, first_interval=0.0)
    return state


def forget(folder: Path) -> None:
    """Look at a folder again when it is next asked for."""
    _, state = _known.pop(os.path.abspath(folder), (0.0, None))
    if state is not None:
        _known[os.path.abspath(folder)] = (-_FRESH_SECONDS, state)


def look(run: RunFolder) -> RunState:
    """The state of a run folder, from the disk."""
    from .bridge.process import find_engine

    engine = find_engine(run)
    warnings, pictures, error = [], (), None
    for message in _messages(run.messages("estimate")):
        if message["type"] == "warning":
            warnings.append(message)
        elif message["type"] == "error":
            error = message
        elif message.get("files") and message["type"] == "progress":
            pictures = tuple(run.root / name for name in message["files"])
    return RunState(
        stages=_stage_count(run.stage / "stages.json"),
        finished=run.statistics_json.exists() and run.emitters_json.exists() and run.fields_npz.exists(),
        engine=engine.command[0] if engine is not None else "",
        warnings=tuple(warnings),
        error=error,
        pictures=pictures,
    )


def _look_soon() -> None:
    while _wanted:
        folder = _wanted.pop()
        _, before = _known.get(folder, (0.0, None))
        state = look(RunFolder(folder))
        _known[folder] = (time.monotonic(), state)
        for listener in _listeners:
            listener(Path(folder), state, state != before)


def _stage_count(path: Path) -> int:
    import json

    try:
        return len(json.loads(path.read_text(encoding="utf-8"))["stages"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def _messages(path: Path) -> list[Message]:
    """The messages of a file that tell more than how far the engine is."""
    from .core.job.messages import parse_message

    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    lines = [line for line in text.splitlines() if '"type": "progress"' not in line or '"files"' in line]
    return [message for line in lines if (message := parse_message(line)) is not None]
