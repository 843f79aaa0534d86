"""Jobs on a run folder.

bpy is imported only to read the preferences, where it exists.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..bridge.interpreter import engine_command, engine_environment, find_engine_python
from ..bridge.job import Job
from ..bridge.process import EngineProcess
from ..bridge.step import Step
from ..core.run.lock import busy, holder
from ..core.run.process_identity import PARENT_VARIABLE
from ..core.run.runfolder import RunFolder
from ..prepare.preparation import PreparationFolder, refuse_foreign


def open_job(
    run: RunFolder,
    steps: Sequence[Step],
    launch: Launch | None = None,
    note: bool = False,
) -> Job:
    """A job of any steps on an existing run folder.

    Args:
        run: the run folder, which also holds the log.
        steps: engine commands and functions on Blender's data.
        launch: the engine, if the caller has found it already; None finds it by the preferences.
        note: whether job.json is written.
    """
    engine = launch or find_launch()
    refuse_busy(run)
    started = [
        replace(step, process=partial(engine.start, step.command, run.log, run.messages(step.command[0])))
        if step.command
        else step
        for step in steps
    ]
    return Job(started, run.log, note=run.job_json if note else None)


def prepare_job(photographs: Path, folder: Path, options: Iterable[str], launch: Launch | None = None) -> Job:
    """A job that makes a capture from photographs in a folder, by the engine's command `prepare`.

    The engine keeps the steps that are finished, so that a stopped job goes on when it is started again.
    """
    refuse_foreign(PreparationFolder(folder), photographs)
    command = ["prepare", *options, "--", str(photographs), str(folder)]
    step = Step("prepare", "Preparing the photographs", 60.0, command=command)
    return open_job(RunFolder(folder), [step], launch=launch)


def refuse_busy(run: RunFolder) -> None:
    """Let two engines never work in one run folder, nor any engine in one whose links lead out of it."""
    run.refuse_links()
    if holder(run) is not None:
        raise busy(run)


@dataclass(frozen=True)
class Launch:
    """How to start the engine: its interpreter and environment variables."""

    python: Path
    environment: Mapping[str, str]

    def start(self, arguments: Sequence[str], log: Path, messages: Path | None = None) -> EngineProcess:
        """Start an engine command; see `EngineProcess`."""
        return EngineProcess(engine_command(self.python, *arguments), log, self.environment, messages)


def find_launch(explicit: str | None = None) -> Launch:
    """The given engine, else that of the preferences (in Blender), else the one that is found."""
    variables: dict[str, str] = {}
    if explicit or importlib.util.find_spec("bpy") is None:
        python = find_engine_python(explicit)
    else:
        from .. import machine

        python = machine.engine_python()
        variables = dict(machine.engine_variables())
    variables[PARENT_VARIABLE] = str(os.getpid())  # it ends with this process; Resume does the rest
    return Launch(python, {**engine_environment(python), **variables})
