# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One step of a job, and the file that remembers which steps are finished, with which inputs.

Standard library only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.job.runfolder import read_json, write_json
from .process import Engine, Message

STEPS_VERSION = 1

# What a step does to Blender's data: at once, returning warnings if any; or as a generator that yields the
# share that is done (0 to 1) or None between slices of work, and returns the warnings.
Slices = Generator[float | None, None, Sequence[Message] | None]
StepFunction = Callable[[], Slices | Sequence[Message] | None]


@dataclass
class Step:
    """One step of a job.

    Attributes:
        name: stable identifier, the key in steps.json.
        text: what the user reads while it runs.
        weight: its expected time in seconds, on a small machine.
        inputs: JSON-serialisable values on which its result depends, besides the steps before it.
        command: arguments of an engine command, or None for a function.
        process: starts another process that writes the engine's messages, instead of an engine command.
        function: what to call on Blender's data, or None for a command; see `StepFunction`.
        outputs: files that must exist for the step to count as finished.
        repeat: whether to do it again when finished, because its result lives in Blender's memory.
        reset: called when inputs changed since a result was written, to remove what is stale.
        restore: brings the work of this step and of all before it back into Blender's memory; called instead
            of them when all are finished and a later step is not.
    """

    name: str
    text: str
    weight: float
    inputs: Mapping[str, Any] = field(default_factory=dict)
    command: Sequence[str] | None = None
    process: Callable[[], Engine] | None = None
    function: StepFunction | None = None
    outputs: Sequence[Path] = ()
    repeat: bool = False
    reset: Callable[[], None] | None = None
    restore: Callable[[], None] | None = None


class StepRecord:
    """steps.json: name → {key, finished, seconds, warnings}."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._steps: dict[str, dict[str, Any]] = {}
        if path.exists():
            data = read_json(path)
            if data.get("version") == STEPS_VERSION and isinstance(data.get("steps"), dict):
                self._steps = data["steps"]

    def key(self, name: str) -> str | None:
        """The key with which a step was last started."""
        entry = self._steps.get(name)
        return entry.get("key") if isinstance(entry, dict) else None

    def forget(self, names: Iterable[str]) -> None:
        """Take some steps for never started; written with the next `store`."""
        for name in names:
            self._steps.pop(name, None)

    def finished(self, step: Step, key: str) -> bool:
        """Whether a step's result for these inputs is there."""
        return (
            self.key(step.name) == key
            and self._steps[step.name].get("finished") is True
            and all(path.exists() for path in step.outputs)
        )

    def store(
        self,
        name: str,
        key: str,
        finished: bool,
        seconds: float = 0.0,
        warnings: Sequence[Message] = (),
    ) -> None:
        """Note that a step was started or finished, and what it warned of.

        Raises:
            FiptError: ``disk-full`` or ``run-unwritable``.
        """
        self._steps[name] = {
            "key": key,
            "finished": finished,
            "seconds": round(seconds, 2),
            "warnings": list(warnings),
        }
        write_json(self._path, {"format": "fipt-steps", "version": STEPS_VERSION, "steps": self._steps})


def chain_keys(steps: Sequence[Step]) -> list[str]:
    """One key a step: the hash of its inputs and of the key before it."""
    keys, previous = [], ""
    for step in steps:
        text = json.dumps([previous, step.name, step.inputs], sort_keys=True, default=str)
        previous = hashlib.sha256(text.encode()).hexdigest()[:24]
        keys.append(previous)
    return keys
