# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on a run folder.

bpy is imported only to read the preferences, where it exists.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..bridge.interpreter import engine_command, engine_environment, find_engine_python
from ..bridge.process import EngineProcess
from ..bridge.sequence import Job
from ..bridge.step import Step, StepRecord
from ..core.capture.options import CaptureOptions
from ..core.run.lock import busy, holder
from ..core.run.process_identity import PARENT_VARIABLE
from ..core.run.runfolder import RunFolder

STEPS_NAME = "steps.json"


def ingest_step(run: RunFolder, capture: Path, options: CaptureOptions, text: str, seconds: float) -> Step:
    """The engine reads and checks a capture.

    Args:
        run: the run folder into which it is read.
        capture: folder or file.
        options: how it is read.
        text: shown to the user while the step runs.
        seconds: expected time, on a small machine.
    """
    command = ["ingest", str(capture), str(run.root), *options.arguments()]
    return Step("ingest", text, seconds, command=command, outputs=[run.ingest_json])


def open_job(
    run: RunFolder,
    steps: Sequence[Step],
    record: str = "",
    resume: bool = False,
    result: Callable[[], list[str]] | None = None,
    launch: Launch | None = None,
) -> Job:
    """A job of any steps on an existing run folder.

    Args:
        run: the run folder, which also holds the log and the steps file.
        steps: engine commands and functions on Blender's data.
        record: name of the steps file, which records finished steps, of a job that can be resumed; jobs that
            share one need different step names.
        resume: whether finished steps with the same inputs are skipped.
        result: called at the end; returns the paths of the results.
        launch: the engine, if the caller has found it already; None finds it by the preferences.

    Raises:
        FiptError: ``engine-missing``, ``run-busy`` or ``run-linked``.
    """
    engine = launch or find_launch()
    refuse_busy(run)
    step_record = StepRecord(run.root / record if record else None)
    if not resume:
        step_record.forget(step.name for step in steps)  # so that each of them runs

    def start(arguments: Sequence[str]) -> EngineProcess:
        command = engine_command(engine.python, *arguments)
        return EngineProcess(command, run.log, engine.environment, run.messages(arguments[0]))

    return Job(
        [replace(step, process=partial(start, step.command)) if step.command else step for step in steps],
        run.log,
        step_record,
        lambda: (result() if result else [], {"run": str(run.root)}),
        resume,
    )


def refuse_busy(run: RunFolder) -> None:
    """Let two engines never work in one run folder, nor any engine in one whose links lead out of it.

    Raises:
        FiptError: ``run-busy`` or ``run-linked``.
    """
    run.refuse_links()
    if holder(run) is not None:
        raise busy(run)


@dataclass(frozen=True)
class Launch:
    """How to start the engine: its interpreter and environment variables."""

    python: Path
    environment: Mapping[str, str]


def find_launch(explicit: str | None = None) -> Launch:
    """The given engine, else that of the preferences (in Blender), else the one that is found.

    Raises:
        FiptError: ``engine-missing``.
    """
    variables: dict[str, str] = {}
    if explicit or importlib.util.find_spec("bpy") is None:
        python = find_engine_python(explicit)
    else:
        from .. import machine

        python = machine.engine_python()
        variables = dict(machine.engine_variables())
    variables[PARENT_VARIABLE] = str(os.getpid())  # it ends with this process; Resume does the rest
    return Launch(python, {**engine_environment(python), **variables})
