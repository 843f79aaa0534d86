"""Jobs whose engine is a script that works until it is told to stop; timers are called by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

import fipt_blender
from fipt_blender.bridge.job import Job
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import running
from samples.child_processes import ENGINE, wait_for

ROOT = Path(fipt_blender.__file__).resolve().parent.parent


def make_job(run: RunFolder, *functions, engine: bool = True, script: str = ENGINE) -> Job:
    """An engine command and then functions on Blender's data."""

    def start():
        command = [sys.executable, "-c", script, str(ROOT), str(run.root)]
        return EngineProcess(command, run.log, messages=run.messages("estimate"))

    steps = [Step("estimate", "Estimating", 10.0, process=start)] if engine else []
    steps += [Step(f"f{i}", f"Function {i}", 1.0, function=each) for i, each in enumerate(functions)]
    return Job(steps, run.log, title="Test", kind="test", scene_name=bpy.context.scene.name)


def tick_until(true) -> None:
    wait_for(lambda: true() or (running.tick(), true())[1], pause=0.01)


def at_work(info: Job) -> bool:
    return bool(info.warnings)


def finish(run: RunFolder, info: Job) -> None:
    (run.root / "stop").touch()
    tick_until(lambda: info.state != "running")
