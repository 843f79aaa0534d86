# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on the data folder: the engine's set-up and its check, measuring and clearing what lies there."""

from __future__ import annotations

import time
from pathlib import Path

from . import preferences, running
from .bridge.interpreter import engine_command, engine_environment, setup_command
from .bridge.pins import other_versions, read_pins
from .bridge.process import EngineProcess
from .bridge.sequence import Job, own_job
from .bridge.step import Step
from .core.job.errors import FiptError
from .core.job.runfolder import PRODUCT_VERSION

_RECORD = "environment.json"


def log_file() -> Path:
    """The log of set-up and check."""
    return preferences.data_folder() / "environment.log"


def data_job(steps: list[Step]) -> Job:
    """A job of steps that start their own processes or are functions, on the data folder."""
    return own_job(steps, preferences.data_folder() / _RECORD, log_file())


def set_up_step(python: Path, data: Path, device: str, wheels: Path | None) -> Step:
    """The step that makes the engine's environment; arguments as of `setup_command`."""
    command = setup_command(python, data, device, wheels)
    return Step(
        "set-up",
        "Setting up the engine",
        180.0,
        process=lambda: start_process(command, engine_environment()),
    )


class EngineStatus:
    """Collects what set-up and check say, and keeps it with the preferences at the end."""

    def __init__(self) -> None:
        self._check: EngineProcess | None = None

    def check_step(self) -> Step:
        """The step that looks at the engine."""
        return Step("check", "Checking the engine", 20.0, process=self._start_check)

    def _start_check(self) -> EngineProcess:
        values = preferences.get_preferences()
        python = preferences.engine_python()
        arguments = ["check", f"--device={values.device}"]
        gpu = preferences.chosen_gpu()
        if gpu:
            arguments.append(f"--gpu={gpu}")
        command = engine_command(python, *arguments)
        self._check = start_process(command, engine_environment(python))
        return self._check

    def store(self, info: running.RunningJob) -> None:
        """Keep the outcome; a cancelled job leaves what is known."""
        if info.state == "cancelled":
            return
        done = self._check.done if self._check is not None else None
        engine = {} if done is None else done["data"]
        if engine and (others := other_versions(read_pins(), engine["packages"])):
            info.warnings.append(
                {
                    "type": "warning",
                    "code": "package-version",
                    "text": f"Packages have other versions than the tested ones: {', '.join(others)}.",
                    "remedy": "If the engine fails, install the tested versions, given in brackets.",
                }
            )
        preferences.store_status(
            {
                "time": time.time(),
                "product_version": PRODUCT_VERSION,
                "engine": engine,
                "warnings": info.warnings,
                "error": info.error,
            }
        )


def start_process(command: list[str], environment: dict[str, str]) -> EngineProcess:
    """Start a process whose log is that of the environment.

    Raises:
        FiptError: ``engine-missing`` where its interpreter can't be started.
    """
    try:
        return EngineProcess(command, log_file(), environment)
    except OSError as error:
        raise FiptError(
            "engine-missing",
            f"{command[0]} can't be started ({error.strerror}).",
            "Name another interpreter, or set up the engine.",
        ) from error
