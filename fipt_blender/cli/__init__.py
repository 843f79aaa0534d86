"""The command line, behind `__main__.py` and `blender --command fipt`.

Exit status: 0 success, 1 the job failed (`error: ...` on stderr), 2 wrong usage, 130 stopped.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ..bridge.job import Job
from ..bridge.process import Message
from ..bridge.step import Step
from ..core.run.errors import FiptError, as_message
from ..core.run.runfolder import explained_write_errors
from ..jobs.main_job import make_main_job
from ..jobs.run_job import find_launch, prepare_job
from .arguments import make_options, make_parser
from .output import Display, interrupts, private_stdout


def main(argv: Sequence[str]) -> int:
    """Run the command line and return its exit status; never raises SystemExit."""
    try:
        arguments = make_parser().parse_args(list(argv))
    except SystemExit as end:  # argparse; Blender would print a traceback
        return end.code if isinstance(end.code, int) else 2
    commands = {"estimate": _estimate, "prepare": _prepare, "export": _export}
    return {**commands, "check": _check}[arguments.command](arguments)


def _estimate(arguments: argparse.Namespace) -> int:
    try:
        options = make_options(arguments)
    except FiptError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        job = make_main_job(options)
    except FiptError as error:
        return _report_error(arguments, error)
    from ..jobs.room_steps import panel_state  # bpy

    with private_stdout(job.log) as stream, panel_state():
        return _run(job, Display(stream, arguments.json, arguments.quiet), "add --resume to the same command")


def _prepare(arguments: argparse.Namespace) -> int:
    photographs = arguments.photographs.absolute()
    capture = (arguments.output or Path.cwd() / f"{photographs.name}-capture").absolute()
    options = [f"--steps={arguments.steps}", *(f"--set={text}" for text in arguments.set)]
    try:
        with explained_write_errors(capture):
            capture.mkdir(parents=True, exist_ok=True)
        job = prepare_job(photographs, capture, options, find_launch(arguments.engine_python))
    except FiptError as error:
        return _report_error(arguments, error)
    return _run(job, Display(sys.stdout, arguments.json, arguments.quiet), "give the same command")


def _export(arguments: argparse.Namespace) -> int:
    import bpy

    from ..blend.export.exporting import export_room

    display = Display(sys.stdout, arguments.json, arguments.quiet)
    blend = arguments.blend.absolute()
    try:
        if not blend.is_file():
            raise FiptError("file-missing.export", blend=blend)
        try:
            bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False, use_scripts=False)
        except RuntimeError as error:
            raise FiptError("file-damaged.export", blend=blend, error=str(error).strip()) from None
        path, options = arguments.file.absolute(), (arguments.texture_size, arguments.lamp_lights)
        exported = export_room(bpy.context.scene, path, *options)
    except FiptError as error:
        return _report_error(arguments, error)
    for warning in exported.warnings:
        display.show(warning)
    display.show({"type": "done", "files": [str(exported.path)], "data": {"objects": exported.objects}})
    return 0


def _check(arguments: argparse.Namespace) -> int:
    log = Path(os.devnull)
    try:
        engine = find_launch(arguments.engine_python)
    except FiptError as error:
        return _report_error(arguments, error)
    start = partial(engine.start, ["check"], log)
    job = Job([Step("check", "Checking the engine", 20.0, process=start)], log)
    job.result = lambda: ([], job.data)
    status = _run(job, Display(sys.stdout, arguments.json, arguments.quiet), "give the same command")
    if not arguments.json and not arguments.quiet:
        for name, value in job.data.items():
            if isinstance(value, dict):
                value = ", ".join(f"{key} {item or 'missing'}" for key, item in value.items())
            print(f"{name.replace('_', ' ')}: {'none' if value is None else value}")
    return status or (0 if job.data.get("ready", True) else 1)


def _run(job: Job, display: Display, again: str) -> int:
    """Run a job and show its messages; `again`: what the user does to continue one that was stopped."""
    with interrupts() as switch:

        def show(message: Message) -> None:
            if message["type"] == "stage":
                switch(not message["name"].startswith("render-"))
            display.show(message)

        try:
            return 0 if job.run(show) else 1
        except KeyboardInterrupt:
            display.end_line()
            print(f"stopped; to continue, {again}.", file=sys.stderr)
            return 130


def _report_error(arguments: argparse.Namespace, error: FiptError) -> int:
    Display(sys.stdout, arguments.json, arguments.quiet).show(as_message("error", error))
    return 1
