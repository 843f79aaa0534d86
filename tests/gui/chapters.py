"""What the story's chapters share."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import agent
import inside

if TYPE_CHECKING:
    from window import Window

_JOB_SECONDS = 600.0
_FAST_SAMPLES = 6  # of viewports, with --fast: then Cycles rests; it counts 4 while its pixels are coarse


@dataclass(frozen=True)
class Options:
    """Options of a run of the story.

    Attributes:
        capture: folder of the example capture.
        engine: interpreter with the engine's packages; it is typed into the preferences.
        fast: few rays and steps, for work on the test itself.
    """

    capture: Path
    engine: Path
    fast: bool = False


@dataclass(frozen=True)
class Chapter:
    """A part of the story.

    Attributes:
        act: drives the window, asserts on Blender's data and takes pictures.
        after: the chapter whose scene it continues; "" for Blender's startup scene.
        anew: whether it opens that scene as it was, since another chapter may have put a room into it.
    """

    act: Callable[[Window, Options], None]
    after: str = ""
    anew: bool = False

    @property
    def name(self) -> str:
        """The function's name."""
        return self.act.__name__


def act(window: Window, options: Options, chapters: Iterable[Chapter]) -> None:
    """Act chapters one after the other; the scene is saved after each.

    Raises:
        AssertionError: something is not as it should be.
    """
    for number, chapter in enumerate(chapters):
        start, presses = time.monotonic(), window.presses
        if chapter.anew or (chapter.after and number == 0):
            window.ask(agent.open_file, str(window.shots / f"{chapter.after}.blend"))
            window.settle()
        if options.fast:
            window.ask(agent.viewport_samples, _FAST_SAMPLES)
        chapter.act(window, options)
        seconds, clicks = time.monotonic() - start, window.presses - presses
        print(f"{chapter.name}: {clicks} clicks, {seconds:.0f} s", file=sys.stderr, flush=True)
        window.ask(agent.save_copy, str(window.shots / f"{chapter.name}.blend"))


def finish(window: Window, kind: str, seconds: float = _JOB_SECONDS) -> dict[str, Any]:
    """Wait for a job to finish without an error, with the pointer out of the way."""
    window.point_in_view()
    job = window.wait(
        inside.job, kind, until=lambda job: job["state"] not in ("", "running"), seconds=seconds, every=0.3
    )
    assert job["state"] == "finished", job
    window.wait(inside.busy, until=lambda busy: not busy, seconds=seconds)  # another job may follow
    window.settle()
    return job
