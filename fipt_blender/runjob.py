# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on a run folder: any steps with the engine that the preferences name, or the engine found there.

bpy is imported only where it is there and the preferences are asked.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from .bridge.interpreter import engine_command, engine_environment, find_engine_python
from .bridge.process import AttachedEngine, EngineProcess, find_engine
from .bridge.sequence import Job
from .bridge.step import Step, StepRecord
from .core.job.errors import FiptError
from .core.job.parent import PARENT_VARIABLE
from .core.job.runfolder import RunFolder

STEPS_NAME = "steps.json"


def open_job(
    run: RunFolder,
    steps: Sequence[Step],
    record: str = STEPS_NAME,
    resume: bool = False,
    result: Callable[[], list[str]] | None = None,
    launch: Launch | None = None,
) -> Job:
    """A job of any steps on a run folder that exists, with the engine that the preferences name.

    Args:
        run: where the engine works, and its log and the steps file lie.
        steps: engine commands and functions on Blender's data.
        record: name of the steps file, which remembers what is finished; jobs that share one need different
            names of steps.
        resume: whether finished steps with the same inputs are skipped; without it all run.
        result: called at the end, gives the paths of what was made.
        launch: the engine where it was found before.

    Raises:
        FiptError: ``engine-missing`` or ``run-busy``.
    """
    engine = launch or find_launch()
    refuse_busy(run)
    started = StepRecord(run.root / record)
    if not resume:
        started.forget(step.name for step in steps)  # each then finds that its result is stale

    def start(arguments: Sequence[str]) -> EngineProcess:
        command = engine_command(engine.python, *arguments)
        try:
            return EngineProcess(command, run.log, engine.environment, run.messages(arguments[0]))
        except OSError as error:
            raise FiptError(
                "engine-missing",
                f"The engine's Python {engine.python} can't be started ({error.strerror}).",
                "Name another interpreter, or create the engine's environment again.",
            ) from error

    return Job(
        steps=steps,
        record=started,
        start_engine=start,
        log=run.log,
        result=lambda: (result() if result else [], {"run": str(run.root)}),
        resume=resume,
    )


def attach_job(run: RunFolder, steps: Sequence[Step], record: str = STEPS_NAME) -> Job | None:
    """A job that watches the engine which works in a run folder already, whoever started it; None without.

    Args:
        run, record: as of `open_job`.
        steps: of the job that may have started it; the one whose command runs is noted as finished at the
            end.
    """
    found = find_engine(run)
    if found is None:
        return None
    name = found.command[0]
    started = StepRecord(run.root / record)
    known = [step for step in steps if step.command and step.command[0] == name]
    step = replace(known[0], reset=None) if known else Step(name, name.capitalize(), 1.0, command=[name])
    return Job(
        steps=[step],
        record=started,
        start_engine=lambda arguments: AttachedEngine(run, found),
        log=run.log,
        result=lambda: ([], {"run": str(run.root)}),
        resume=False,
        keys=[started.key(step.name) or ""],
    )


def refuse_busy(run: RunFolder) -> None:
    """Let two engines never work in one run folder.

    Raises:
        FiptError: ``run-busy``.
    """
    if find_engine(run) is not None:
        raise FiptError(
            "run-busy",
            f"An engine works in {run.root} already.",
            "Wait for its end, or stop it where it was started.",
        )


@dataclass(frozen=True)
class Launch:
    """How the engine is started: its interpreter and environment."""

    python: Path
    environment: Mapping[str, str]


def find_launch(explicit: str | None = None) -> Launch:
    """The engine that is named, else the preferences' one (in Blender), else the one that is found.

    Raises:
        FiptError: ``engine-missing``.
    """
    variables: dict[str, str] = {}
    window = False
    if explicit or importlib.util.find_spec("bpy") is None:
        python = find_engine_python(explicit)
    else:
        import bpy

        from . import preferences

        python, window = preferences.engine_python(), not bpy.app.background
        variables = dict(preferences.engine_variables())
    if not window:  # nobody could watch it again
        variables[PARENT_VARIABLE] = str(os.getpid())
    return Launch(python, {**engine_environment(python), **variables})
