"""Jobs on the data folder: set up and check the engine, delete its contents."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from .. import machine
from ..bridge.interpreter import engine_command, engine_environment, setup_command
from ..bridge.job import Job
from ..bridge.pins import other_versions, read_pins
from ..bridge.process import EngineProcess
from ..bridge.step import Step
from ..core.run.errors import warning
from ..core.run.runfolder import PRODUCT_VERSION, explained_write_errors
from . import running
from .tasks import Task


def data_task(
    title: str,
    make: Callable[[], list[Step]],
    ended: Callable[[Job], None] | None = None,
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


def check_step() -> Step:
    """The step that checks the engine."""

    def start() -> EngineProcess:
        python = machine.engine_python()
        arguments = ["check", f"--device={machine.device_setting()}"]
        gpu = machine.chosen_gpu()
        if gpu:
            arguments.append(f"--gpu={gpu}")
        command = engine_command(python, *arguments)
        return EngineProcess(command, machine.set_up_log(), engine_environment(python))

    return Step("check", "Checking the engine", 20.0, process=start)


def store_status(job: Job, set_up: bool = False) -> None:
    """Store how a check has ended, after set-up or alone, in the preferences.

    Of a cancelled set-up only that is stored, of a cancelled check nothing.
    """
    if job.state == "cancelled":
        if set_up:
            machine.store_status({**machine.status(), "cancelled": True})
        return
    engine = {} if job.error else job.data
    if engine and (others := other_versions(read_pins(), engine["packages"])):
        job.warnings.append(warning("package-version", packages=", ".join(others)))
    machine.store_status(
        {
            "time": time.time(),
            "product_version": PRODUCT_VERSION,
            "engine": engine,
            "warnings": job.warnings,
            "error": job.error,
        }
    )
