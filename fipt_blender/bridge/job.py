"""A job: steps one after another, each an engine command or a function on Blender's data.

In a window a timer calls `advance`; background runs call `run`. Standard library only.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.run.contents import JobNote
from ..core.run.errors import FiptError, Problem, as_message
from ..core.run.runfolder import full_disk, write_json
from .process import EngineProcess, Message
from .step import JobProgress, Step, StepSlices

QUIET_SECONDS = 5.0  # of an engine, after which the time that is left is told anew
POLL_SECONDS = 0.05  # between looks at an engine by `run`
SLICE_SECONDS = 0.05  # time for which a function on Blender's data works in one call of `advance`


@dataclass(eq=False)
class Job:
    """Runs steps one after another, and has what panels show of that, during and after it.

    It keeps no references to Blender's objects, so it survives undo and the loading of files.

    Attributes:
        steps: in order; each has a function or starts a process.
        log: file for tracebacks of functions; its folder is where the engine works.
        result: called at the end; returns files and data for the message `done`.
        note: file for the seconds of the steps and their warnings (`JobNote`).
        around: makes the context in which functions on Blender's data run, a new one for each slice; it
            raises FiptError if they can't run now.
        title: name for the user, e.g. "Estimate".
        kind: section that started it, e.g. "estimate".
        scene_name: scene whose data it works on; "" for none.
        started: when its work began, in seconds of `time.monotonic`.
        ended: whether `advance` has nothing more to do.
        cancelled: whether it was asked to stop.
        error: the message `error` that ended it, or None.
        warnings: warning messages (code, text, remedy), oldest first.
        stage_text: text of the current stage.
        fraction: finished share of the whole job, 0 to 1.
        remaining_seconds: expected time to the end; None while unknown.
        memory_gb: the engine's peak memory.
        pictures: newest preview images, base colour and emission of a view.
        data: what its last engine command has answered.
    """

    steps: Sequence[Step]
    log: Path
    result: Callable[[], tuple[list[str], dict[str, Any]]] = lambda: ([], {})
    note: Path | None = None
    around: Callable[[], AbstractContextManager[Any]] = nullcontext
    title: str = ""
    kind: str = ""
    scene_name: str = ""
    started: float = field(default_factory=time.monotonic)
    ended: bool = False
    cancelled: bool = False
    error: Message | None = None
    warnings: list[Message] = field(default_factory=list)
    stage_text: str = ""
    fraction: float = 0.0
    remaining_seconds: float | None = None
    memory_gb: float = 0.0
    pictures: list[Path] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._position = -1
        self._heard = 0.0  # when the engine has last sent something
        self._announced = False
        self._process: EngineProcess | None = None
        self._slices: StepSlices | None = None
        self._seconds: dict[str, float] = {}  # of finished steps
        self._progress = JobProgress(self.steps)

    @property
    def run_folder(self) -> Path:
        """Where its engine works."""
        return self.log.parent

    @property
    def state(self) -> str:
        """ "running", "finished", "failed" or "cancelled"."""
        if not self.ended:
            return "running"
        return "failed" if self.error else "cancelled" if self.cancelled else "finished"

    @property
    def stopping(self) -> bool:
        """Whether it was asked to stop and still runs."""
        return self.cancelled and not self.ended

    @property
    def worked_seconds(self) -> float:
        """Time since its work began."""
        return time.monotonic() - self.started

    @property
    def waits(self) -> bool:
        """Whether an engine command is running, so that `advance` may be called less often."""
        return self._process is not None

    def advance(self) -> list[Message]:
        """Do what can be done now, and return the new messages since the last call.

        This never waits for engine commands. A function on Blender's data starts in the call after the one
        that announces it, so that a window can show its text first. It runs to its end or, if it is a
        generator, for `SLICE_SECONDS` per call.
        """
        if self.ended:
            return []
        try:
            messages = self._advance()
        except FiptError as error:
            self._close_slices()
            messages = self._fail(as_message("error", error))
        for message in messages:
            self._take(message)
        return messages

    def run(self, on_message: Callable[[Message], None] | None = None) -> bool:
        """Work until the end and pass on each message; returns whether the job succeeded.

        Any exception, also one by Ctrl-C, first cancels the job.
        """
        try:
            while not self.ended:
                for message in self.advance():
                    if on_message is not None:
                        on_message(message)
                if self._process is not None and self._process.running:
                    time.sleep(POLL_SECONDS)
        except BaseException:
            self.cancel()
            raise
        return self.error is None and not self.cancelled

    def cancel(self) -> None:
        """End the job and its engine; finished steps are kept."""
        if not self.ended:
            self.ended = self.cancelled = True
        self._close_slices()
        if self._process is not None:
            self._process.cancel()
            self._process = None

    def request_cancel(self) -> None:
        """End the job without waiting; `advance` makes sure that the engine ends within two seconds."""
        if self.ended:
            return
        self.cancelled = True
        self._close_slices()
        if self._process is None:
            self.ended = True
        else:
            self._process.request_cancel()

    def _advance(self) -> list[Message]:
        if self._process is not None:
            return self._watch(self._process)
        if self._slices is not None:
            return self._slice(self._slices)
        if not self._announced:
            return self._announce_next()
        step = self.steps[self._position]
        self._announced = False
        if step.process is not None:
            self._process = step.process()
            self._heard = time.monotonic()
            return []
        assert step.function is not None
        with self._explained(step):
            result = step.function()
        if isinstance(result, Generator):
            self._slices = result
            return []
        return self._end_function(result)

    def _slice(self, slices: StepSlices) -> list[Message]:
        """Let a generator work for `SLICE_SECONDS`."""
        fraction, ended, warnings = None, False, None
        until = time.monotonic() + SLICE_SECONDS
        with self._explained(self.steps[self._position]):
            while not ended and time.monotonic() < until:
                try:
                    fraction = next(slices)
                except StopIteration as end:
                    ended, warnings = True, end.value
        if ended:
            self._slices = None
            return self._end_function(warnings)
        return [] if fraction is None else [self._progress_message(fraction)]

    def _end_function(self, warnings: Sequence[Message] | None) -> list[Message]:
        return [*(warnings or ()), *self._complete()]

    def _close_slices(self) -> None:
        if self._slices is not None:
            slices, self._slices = self._slices, None
            slices.close()

    def _announce_next(self) -> list[Message]:
        self._position += 1
        if self.note is not None and self._seconds:
            warnings = (Problem(each["code"], each["text"], each["remedy"]) for each in self.warnings)
            write_json(self.note, JobNote(self._seconds, tuple(warnings)))
        if self._position >= len(self.steps):
            self.ended = True
            files, data = self.result()
            return [{"type": "done", "files": files, "data": data}]
        step = self.steps[self._position]
        self._announced = True
        self._progress.begin()
        stage = {"type": "stage", "name": step.name, "index": self._position, "count": len(self.steps)}
        return [{**stage, "text": step.text}, self._progress_message(0.0)]

    def _watch(self, process: EngineProcess) -> list[Message]:
        step = self.steps[self._position]
        messages, received = [], process.poll()
        if received:
            self._heard = time.monotonic()
        elif not self.cancelled and time.monotonic() - self._heard > QUIET_SECONDS:
            self._heard = time.monotonic()
            messages.append(self._progress.quiet_message(self._position))
        for message in received:
            if message["type"] == "progress":
                self._progress.note_memory(float(message.get("memory_gb") or 0.0))
                fraction, remaining = message.get("fraction", 0.0), message.get("remaining_seconds")
                pictures = {"files": message["files"]} if "files" in message else {}
                messages.append({**self._progress_message(fraction, remaining), **pictures})
            elif message["type"] == "stage":
                place = {"index": self._position, "count": len(self.steps)}
                messages.append({**message, "name": f"{step.name}/{message['name']}", **place})
            elif message["type"] in ("warning", "note"):
                messages.append(message)
            elif message["type"] == "done":
                self.data = message["data"]
            elif message["type"] == "error":
                process.error = message
        if not process.running:
            self._process = None
            if self.cancelled:
                self.ended = True
                return messages
            if process.error is not None:
                return messages + self._fail(process.error)
            messages += self._complete()
        return messages

    @contextmanager
    def _explained(self, step: Step) -> Iterator[None]:
        """Run a function on Blender's data in its context; any exception becomes a FiptError."""
        try:
            with self.around():
                yield
        except FiptError:
            raise
        except Exception as error:  # every failure must reach the user
            if full := full_disk(error):
                raise full from error
            with suppress(OSError), open(self.log, "a", encoding="utf-8") as log:
                log.write(traceback.format_exc())
            raise FiptError(
                "blender-step-failed", text=step.text, kind=type(error).__name__, error=error, log=self.log
            ) from error

    def _complete(self) -> list[Message]:
        message = self._progress_message(1.0)
        self._seconds[self.steps[self._position].name] = round(self._progress.complete(self._position), 2)
        return [message]

    def _take(self, message: Message) -> None:
        """Keep what panels show of a message."""
        kind = message["type"]
        if kind == "stage":
            self.stage_text = message["text"]
        elif kind == "progress":
            self.fraction, self.remaining_seconds = message["fraction"], message["remaining_seconds"]
            self.memory_gb = message["memory_gb"]
            if files := message.get("files"):
                self.pictures = [self.run_folder / name for name in files]
        elif kind == "warning":
            self.warnings.append(message)

    def _progress_message(self, step_fraction: float, step_remaining: float | None = None) -> Message:
        return self._progress.message(self._position, step_fraction, step_remaining)

    def _fail(self, message: Message) -> list[Message]:
        self.error = message
        self.ended = True
        return [message]
