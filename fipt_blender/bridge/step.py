# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One step of a job, and the file that records which steps are finished and with which inputs.

Standard library only.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ..core.run.contents import Problem, StepNote, Steps
from ..core.run.documents import read_document
from ..core.run.errors import FiptError
from ..core.run.lock import briefly_locked
from ..core.run.runfolder import write_json
from .process import EngineProcess, Message

Result = TypeVar("Result")
# Work in slices: a generator that yields the share that is done (0 to 1), or None, between two slices.
Slices = Generator[float | None, None, Result]
# A function on Blender's data, which works at once or in slices and returns its warnings, if any.
StepSlices = Slices[Sequence[Message] | None]
StepFunction = Callable[[], StepSlices | Sequence[Message] | None]


@dataclass
class Step:
    """One step of a job.

    Attributes:
        name: stable identifier, the key in steps.json.
        text: shown to the user while the step runs.
        weight: expected time in seconds, on a small machine, before anything is known of the capture.
        expected: the same from what the steps before have found; None while that is unknown, and with it the
            time that the job will take.
        inputs: JSON-serialisable values on which the result depends besides the steps before.
        command: arguments of an engine command, which becomes the process in a job on a run folder.
        process: starts a process that writes messages like the engine's.
        function: instead of a process, is called on Blender's data; see `StepFunction`.
        outputs: files that must exist if the step counts as finished.
        repeat: whether a finished step is done again because its result exists only in Blender's memory.
        reset: called to remove stale results if the inputs have changed.
        restore: restores the result of this step and of all before it in Blender's memory; called instead of
            these steps if all of them are finished and a later step is not.
    """

    name: str
    text: str
    weight: float
    inputs: Mapping[str, Any] = field(default_factory=dict)
    command: Sequence[str] | None = None
    process: Callable[[], EngineProcess] | None = None
    function: StepFunction | None = None
    outputs: Sequence[Path] = ()
    repeat: bool = False
    reset: Callable[[], None] | None = None
    restore: Callable[[], None] | None = None
    expected: Callable[[], float | None] | None = None

    def seconds(self) -> float:
        """Expected time."""
        known = None if self.expected is None else self.expected()
        return self.weight if known is None else known


_VERSION = 1  # of steps.json


class StepRecord:
    """The file steps.json: key, finished, seconds and warnings by the name of a step.

    A damaged file counts as none, and jobs that are not resumed have none. Another Blender may work on the
    same run folder: what it has recorded meanwhile stays in the file.

    Attributes:
        problem: why the file could not be read, "" without a problem.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._steps: dict[str, StepNote] = {}
        self._changed: set[str] = set()  # steps that this record has stored or forgotten
        self.problem = ""
        try:
            self._steps = self._read()
        except FiptError as error:
            self.problem = error.text

    def key(self, name: str) -> str | None:
        """The key with which a step was last started, or None."""
        return self._steps[name].key if name in self._steps else None

    def warnings(self, name: str) -> list[Message]:
        """The warnings with which a step has finished."""
        noted = self._steps[name].warnings if name in self._steps else ()
        return [{"type": "warning", **asdict(warning)} for warning in noted]

    def forget(self, names: Iterable[str]) -> None:
        """Forget the entries of some steps; the file is written with the next `store`."""
        for name in names:
            self._steps.pop(name, None)
            self._changed.add(name)

    def finished(self, step: Step, key: str) -> bool:
        """Whether a step is finished with this key and its outputs exist."""
        return (
            self.key(step.name) == key
            and self._steps[step.name].finished
            and all(path.exists() for path in step.outputs)
        )

    def store(
        self, name: str, key: str, finished: bool, seconds: float = 0.0, warnings: Sequence[Message] = ()
    ) -> None:
        """Record that a step was started or finished, with its warnings.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        noted = tuple(Problem(each["code"], each["text"], each["remedy"]) for each in warnings)
        self._steps[name] = StepNote(key, finished, round(seconds, 2), noted)
        self._changed.add(name)
        if self._path is None:
            return
        with briefly_locked(self._path.with_name(f".{self._path.name}.lock")):
            self._take_others()
            write_json(self._path, Steps(_VERSION, self._steps))

    def _read(self) -> dict[str, StepNote]:
        """The steps in the file.

        Raises:
            FiptError: ``file-damaged``.
        """
        if self._path is None or not self._path.exists():
            return {}
        record = read_document(self._path, Steps)
        return dict(record.steps) if record.version == _VERSION else {}

    def _take_others(self) -> None:
        """Take what others have written into the file since it was read."""
        with suppress(FiptError):  # damaged since: it is written anew
            others = {name: entry for name, entry in self._read().items() if name not in self._changed}
            own = {name: entry for name, entry in self._steps.items() if name in self._changed}
            self._steps = {**others, **own}


def chain_keys(steps: Sequence[Step]) -> list[str]:
    """The key of each step: a hash of its name, its inputs and the key before it."""
    keys, previous = [], ""
    for step in steps:
        text = json.dumps([previous, step.name, step.inputs], sort_keys=True, default=str)
        previous = hashlib.sha256(text.encode()).hexdigest()[:24]
        keys.append(previous)
    return keys


_PRIOR_SECONDS = 30.0  # weight, against measured time, of the assumption that expected times are right


class JobProgress:
    """Fraction and remaining time of a job.

    Of steps whose time is expected from the capture, the time that they take says how fast the machine is; of
    others, which are guessed, it does so only where there are none of these.

    Args:
        steps: of the job.
        skipped: whether each step is left out.
    """

    def __init__(self, steps: Sequence[Step], skipped: Sequence[bool]) -> None:
        self._steps = list(steps)
        self._weights = [step.seconds() for step in steps]  # expected seconds, on a small machine
        self._skipped = list(skipped)
        known = [step.expected is not None for step in steps]
        self._unknown = self._unread(0)
        self._telling = known if any(known) else [True] * len(known)
        self._worked = self._taken = 0.0  # expected and real seconds of finished steps that tell the pace
        self._started = time.monotonic()  # of the current step
        self._shown = self._memory_gb = 0.0
        self._last: tuple[float, float | None, float] = (
            0.0,
            None,
            self._started,
        )  # told by `message`, and when

    def note_memory(self, memory_gb: float) -> None:
        """Take an engine's peak memory in GB into account."""
        self._memory_gb = max(self._memory_gb, memory_gb)

    def begin(self) -> None:
        """A step begins."""
        self._started = time.monotonic()
        self._last = 0.0, None, self._started

    def complete(self, index: int) -> float:
        """A step is finished: returns its seconds; later ones are expected by what it has found."""
        seconds = time.monotonic() - self._started
        if self._telling[index]:
            self._worked, self._taken = self._worked + self._weights[index], self._taken + seconds
        else:
            self._weights[index] = max(self._weights[index], seconds)
        for later in range(index + 1, len(self._steps)):
            self._weights[later] = self._steps[later].seconds()
        self._unknown = self._unread(index + 1)
        return seconds

    def _unread(self, begin: int) -> bool:
        """Whether the time of a step from `begin` on follows from what no step has read yet."""
        rest = zip(self._steps[begin:], self._skipped[begin:], strict=True)
        return any(
            step.expected is not None and step.expected() is None for step, skipped in rest if not skipped
        )

    def quiet_message(self, index: int) -> dict[str, Any]:
        """The last message again while the step works on: less is left."""
        fraction, remaining, told = self._last
        passed = time.monotonic() - told
        return self.message(index, fraction, None if remaining is None else max(remaining - passed, 0.0))

    def message(self, index: int, step_fraction: float, step_remaining: float | None) -> dict[str, Any]:
        """The message `progress` of the job; its fraction never falls.

        Args:
            index: of the current step.
            step_fraction: share of the step that is done.
            step_remaining: remaining seconds of the step if known.
        """
        self._last = step_fraction, step_remaining, time.monotonic()
        weight, share = self._weights[index], min(max(step_fraction, 0.0), 1.0)
        work = [0.0 if skipped else each for each, skipped in zip(self._weights, self._skipped, strict=True)]
        worked, taken = self._worked + _PRIOR_SECONDS, self._taken + _PRIOR_SECONDS
        if self._telling[index]:
            worked, taken = worked + weight * share, taken + time.monotonic() - self._started
        pace = taken / worked  # at first close to 1, as the first steps say little
        after = sum(work[index + 1 :])
        current = weight * (1.0 - share) * pace if step_remaining is None else step_remaining
        total = sum(self._weights) or 1.0
        self._shown = max(self._shown, (total - after - weight * (1.0 - share)) / total)
        return {
            "type": "progress",
            "fraction": round(self._shown, 4),
            "stage_fraction": round(step_fraction, 4),
            "remaining_seconds": None if self._unknown else round(current + after * pace, 1),
            "memory_gb": self._memory_gb,
        }
