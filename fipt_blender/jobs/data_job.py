# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on the data folder: set up and check the engine, delete its contents."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from .. import machine
from ..bridge.interpreter import engine_command, engine_environment, setup_command
from ..bridge.pins import other_versions, read_pins
from ..bridge.process import EngineProcess
from ..bridge.sequence import Job
from ..bridge.step import Step
from ..core.run.runfolder import PRODUCT_VERSION, explained_write_errors
from . import running
from .tasks import Task


def data_task(
    title: str,
    make: Callable[[], list[Step]],
    ended: Callable[[running.RunningJob], None] | None = None,
) -> Task:
    """Work on the data folder, of steps that are functions or start their own processes; see `Task`."""
    data = machine.data_folder()

    def make_job(_: object) -> Job:
        with explained_write_errors(data):
            data.mkdir(parents=True, exist_ok=True)
        return Job(make(), machine.set_up_log())

    return Task(title, running.DATA_KIND, make_job, folder=data, ended=ended)


def set_up_step(python: Path, data: Path, device: str, wheels: Path | None) -> Step:
    """The step that creates the engine's environment; for the arguments see `setup_command`."""
    command = setup_command(python, data, device, wheels)
    log = machine.set_up_log()
    return Step(
        "set-up",
        "Setting up the engine",
        180.0,
        process=lambda: EngineProcess(command, log, engine_environment()),
    )


class EngineStatus:
    """Collects the results of set-up and check, and stores them in the preferences at the end.

    Args:
        set_up: whether the job sets up the engine before it checks it.
    """

    def __init__(self, set_up: bool = False) -> None:
        self._set_up = set_up
        self._check: EngineProcess | None = None

    def check_step(self) -> Step:
        """The step that checks the engine."""
        return Step("check", "Checking the engine", 20.0, process=self._start_check)

    def _start_check(self) -> EngineProcess:
        python = machine.engine_python()
        arguments = ["check", f"--device={machine.device_setting()}"]
        gpu = machine.chosen_gpu()
        if gpu:
            arguments.append(f"--gpu={gpu}")
        command = engine_command(python, *arguments)
        self._check = EngineProcess(command, machine.set_up_log(), engine_environment(python))
        return self._check

    def store(self, info: running.RunningJob) -> None:
        """Store the outcome; of a cancelled set-up only that, of a cancelled check nothing."""
        if info.state == "cancelled":
            if self._set_up:
                machine.store_status({**machine.status(), "cancelled": True})
            return
        done = self._check.done if self._check is not None else None
        engine = {} if done is None else done["data"]
        if engine and (others := other_versions(read_pins(), engine["packages"])):
            info.warnings.append(
                {
                    "type": "warning",
                    "code": "package-version",
                    "text": f"Some packages have untested versions: {', '.join(others)}.",
                    "remedy": "If the engine fails, install the tested versions (in parentheses).",
                }
            )
        machine.store_status(
            {
                "time": time.time(),
                "product_version": PRODUCT_VERSION,
                "engine": engine,
                "warnings": info.warnings,
                "error": info.error,
            }
        )
