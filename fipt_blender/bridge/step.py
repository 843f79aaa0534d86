"""One step of a job, and how far a job is.

Standard library only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from .process import EngineProcess, Message

Result = TypeVar("Result")
# Work in slices: a generator that yields the share that is done (0 to 1), or None, between two slices.
Slices = Generator[float | None, None, Result]
# A function on Blender's data, which works at once or in slices and returns its warnings, if any.
StepSlices = Slices[Sequence[Message] | None]
StepFunction = Callable[[], StepSlices | Sequence[Message] | None]


@dataclass(frozen=True)
class Step:
    """One step of a job.

    Each does only what is missing: an engine command keeps what an earlier run has made of the same input.

    Attributes:
        name: stable identifier.
        text: shown to the user while the step runs.
        weight: expected time in seconds, on a small machine, before anything is known of the capture.
        command: arguments of an engine command, which becomes the process in a job on a run folder.
        process: starts a process that writes messages like the engine's.
        function: instead of a process, is called on Blender's data; see `StepFunction`.
        expected: the time from what the steps before have found; None while that is unknown, and with it the
            time that the job will take.
    """

    name: str
    text: str
    weight: float
    command: Sequence[str] | None = None
    process: Callable[[], EngineProcess] | None = None
    function: StepFunction | None = None
    expected: Callable[[], float | None] | None = None

    def seconds(self) -> float:
        """Expected time."""
        known = None if self.expected is None else self.expected()
        return self.weight if known is None else known


_PRIOR_SECONDS = 30.0  # weight, against measured time, of the assumption that expected times are right


class JobProgress:
    """Fraction and remaining time of a job.

    Of steps whose time is expected from the capture, the time that they take says how fast the machine is; of
    others, which are guessed, it does so only where there are none of these.

    Args:
        steps: of the job.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self._steps = list(steps)
        self._weights = [step.seconds() for step in steps]  # expected seconds, on a small machine
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
        return any(step.expected is not None and step.expected() is None for step in self._steps[begin:])

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
        worked, taken = self._worked + _PRIOR_SECONDS, self._taken + _PRIOR_SECONDS
        if self._telling[index]:
            worked, taken = worked + weight * share, taken + time.monotonic() - self._started
        pace = taken / worked  # at first close to 1, as the first steps say little
        after = sum(self._weights[index + 1 :])
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
