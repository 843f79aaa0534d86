# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A job: a sequence of steps, each an engine command or a function on Blender's data.

In a window a timer calls `advance`; background runs call `run`. Standard library only.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from ..core.run.errors import FiptError
from .process import EngineProcess, Message
from .step import JobProgress, Step, StepRecord, StepSlices, chain_keys

QUIET_SECONDS = 5.0  # of an engine, after which the time that is left is told anew
SLICE_SECONDS = 0.05  # time for which a function on Blender's data works in one call of `advance`


class Job:
    """Runs steps one after another and turns their messages into messages of the job.

    Args:
        steps: in order; each has a function or starts a process.
        log: file for tracebacks of functions.
        record: the steps that an earlier run has finished; None for a job that is never resumed.
        result: called at the end; returns files and data for the message `done`.
        resume: whether finished steps are skipped.

    Attributes:
        error: the message `error` that ended the job, or None.
        cancelled: whether `cancel` ended it.
        around: makes the context in which functions on Blender's data run, a new one for each slice; it
            raises FiptError if they can't run now.
    """

    def __init__(
        self,
        steps: Sequence[Step],
        log: Path,
        record: StepRecord | None = None,
        result: Callable[[], tuple[list[str], dict[str, Any]]] = lambda: ([], {}),
        resume: bool = False,
    ) -> None:
        self.error: Message | None = None
        self.cancelled = False
        self.around: Callable[[], AbstractContextManager[Any]] = nullcontext
        self._steps = list(steps)
        self._keys = chain_keys(self._steps)
        self._record = record or StepRecord(None)
        self._log = log
        self._result = result
        self._modes = self._plan() if resume else ["run"] * len(self._steps)
        self._position = -1
        self._heard = 0.0  # when the engine has last sent something
        self._announced = False
        self._process: EngineProcess | None = None
        self._slices: StepSlices | None = None
        self._ended = False
        self._warnings: list[Message] = []
        self._progress = JobProgress(self._steps, [mode != "run" for mode in self._modes])

    def _plan(self) -> list[str]:
        """The mode of each step: "run", "skip" or "restore".

        Finished steps before the first unfinished one are skipped, except for steps whose result exists only
        in Blender's memory.
        """
        modes: list[str] = []
        needed = intact = True
        for step, key in zip(self._steps, self._keys, strict=True):
            if not step.repeat:
                intact = intact and self._record.finished(step, key)
            if intact and step.restore is not None:
                modes = ["skip"] * len(modes) + ["restore"]
            else:
                modes.append("skip" if intact and not step.repeat else "run")
            needed = not intact
        return modes if needed else ["skip"] * len(modes)

    @property
    def finished(self) -> bool:
        """Whether `advance` has nothing more to do."""
        return self._ended

    @property
    def waits(self) -> bool:
        """Whether an engine command is running, so that `advance` may be called less often."""
        return self._process is not None

    @property
    def step(self) -> Step | None:
        """The step that is running or announced."""
        return self._steps[self._position] if 0 <= self._position < len(self._steps) else None

    def advance(self) -> list[Message]:
        """Do what can be done now, and return the new messages since the last call.

        This never waits for engine commands. A function on Blender's data starts in the call after the one
        that announces it, so that a window can show its text first. It runs to its end or, if it is a
        generator, for `SLICE_SECONDS` per call.
        """
        if self._ended:
            return []
        try:
            return self._advance()
        except FiptError as error:
            self._close_slices()
            return self._fail(
                {"type": "error", "code": error.code, "text": error.text, "remedy": error.remedy}
            )

    def run(self, on_message: Callable[[Message], None], interval: float = 0.05) -> bool:
        """Work until the end and pass on each message; returns whether the job succeeded.

        Any exception, also one by Ctrl-C, first cancels the job.
        """
        try:
            while not self._ended:
                for message in self.advance():
                    on_message(message)
                if self._process is not None and self._process.running:
                    time.sleep(interval)
        except BaseException:
            self.cancel()
            raise
        return self.error is None and not self.cancelled

    def cancel(self) -> None:
        """End the job and its engine; finished steps are kept."""
        if not self._ended:
            self._ended = True
            self.cancelled = True
        self._close_slices()
        if self._process is not None:
            self._process.cancel()
            self._process = None

    def request_cancel(self) -> None:
        """End the job without waiting; `advance` makes sure that the engine ends within two seconds."""
        if self._ended:
            return
        self.cancelled = True
        self._close_slices()
        if self._process is None:
            self._ended = True
        else:
            self._process.request_cancel()

    def _advance(self) -> list[Message]:
        if self._process is not None:
            return self._watch(self._process)
        if self._slices is not None:
            return self._slice(self._slices)
        if not self._announced:
            return self._announce_next()
        step = self._steps[self._position]
        self._announced = False
        if self._modes[self._position] != "restore" and step.process is not None:
            self._process = step.process()
            self._heard = time.monotonic()
            return []
        function = step.restore if self._modes[self._position] == "restore" else step.function
        assert function is not None
        with self._explained(step):
            result = function()
        if isinstance(result, Generator):
            self._slices = result
            return []
        return self._end_function(result)

    def _slice(self, slices: StepSlices) -> list[Message]:
        """Let a generator work for `SLICE_SECONDS`."""
        fraction, ended, warnings = None, False, None
        until = time.monotonic() + SLICE_SECONDS
        with self._explained(self._steps[self._position]):
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
        if self._modes[self._position] == "restore":
            return []
        self._warnings = list(warnings or ())
        return [*self._warnings, *self._complete(self._steps[self._position])]

    def _close_slices(self) -> None:
        if self._slices is not None:
            slices, self._slices = self._slices, None
            slices.close()

    def _announce_next(self) -> list[Message]:
        self._position += 1
        repeated: list[Message] = []  # what finished steps have warned of, for this session's user
        if self._position == 0 and self._record.problem:
            text = f"{self._record.problem} All steps are done again."
            remedy = "There is nothing to do."
            repeated.append({"type": "warning", "code": "steps-damaged", "text": text, "remedy": remedy})
        while self._position < len(self._steps) and self._modes[self._position] == "skip":
            repeated += self._record.warnings(self._steps[self._position].name)
            self._position += 1
        if self._position >= len(self._steps):
            self._ended = True
            files, data = self._result()
            return [*repeated, {"type": "done", "files": files, "data": data}]
        step, key = self._steps[self._position], self._keys[self._position]
        if self._modes[self._position] == "restore":
            self._announced = True
            return [*repeated, *self._record.warnings(step.name)]
        if step.reset is not None and self._record.key(step.name) != key:
            step.reset()
        if not (step.repeat and self._record.finished(step, key)):
            self._record.store(step.name, key, finished=False)
        self._announced = True
        self._progress.begin()
        self._warnings = []
        stage = {"type": "stage", "name": step.name, "index": self._position, "count": len(self._steps)}
        return [*repeated, {**stage, "text": step.text}, self._progress_message(0.0)]

    def _watch(self, process: EngineProcess) -> list[Message]:
        step = self._steps[self._position]
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
                place = {"index": self._position, "count": len(self._steps)}
                messages.append({**message, "name": f"{step.name}/{message['name']}", **place})
            elif message["type"] == "warning":
                self._warnings.append(message)
                messages.append(message)
            elif message["type"] == "note":
                messages.append(message)
            elif message["type"] == "error":
                process.error = message
        if not process.running:
            self._process = None
            if self.cancelled:
                self._ended = True
                return messages
            if process.error is not None:
                return messages + self._fail(process.error)
            messages += self._complete(step)
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
            with suppress(OSError), open(self._log, "a", encoding="utf-8") as log:
                log.write(traceback.format_exc())
            raise FiptError(
                "blender-step-failed",
                f"The step '{step.text}' failed: {type(error).__name__}: {error}",
                f"See {self._log}, and please report the problem.",
            ) from error

    def _complete(self, step: Step) -> list[Message]:
        message = self._progress_message(1.0)
        seconds = self._progress.complete(self._position)
        self._record.store(step.name, self._keys[self._position], True, seconds, self._warnings)
        return [message]

    def _progress_message(self, step_fraction: float, step_remaining: float | None = None) -> Message:
        return self._progress.message(self._position, step_fraction, step_remaining)

    def _fail(self, message: Message) -> list[Message]:
        self.error = message
        self._ended = True
        return [message]
