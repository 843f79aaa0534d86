# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, behind `__main__.py` and `blender --command fipt`.

Exit status: 0 success, 1 the job failed (`error: ...` on stderr), 2 wrong usage, 130 stopped.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ..bridge.interpreter import engine_command
from ..bridge.process import EngineProcess, Message
from ..core.run.errors import FiptError
from ..core.run.runfolder import explained_write_errors
from ..jobs.main_job import make_main_job
from ..jobs.run_job import find_launch
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
    run_log = options.output / "log.txt"
    with private_stdout(run_log) as stream, interrupts() as switch:
        display = Display(stream, arguments.json, arguments.quiet)

        def show(message: Message) -> None:
            if message["type"] == "stage":
                switch(not message["name"].startswith("render-"))
            display.show(message)

        try:
            succeeded = job.run(show)
        except KeyboardInterrupt:
            display.end_line()
            print("stopped; to continue, add --resume to the same command.", file=sys.stderr)
            return 130
    return 0 if succeeded else 1


def _prepare(arguments: argparse.Namespace) -> int:
    photographs = arguments.photographs.absolute()
    capture = (arguments.output or Path.cwd() / f"{photographs.name}-capture").absolute()
    options = [f"--steps={arguments.steps}", *(f"--set={text}" for text in arguments.set)]
    try:
        with explained_write_errors(capture):
            capture.mkdir(parents=True, exist_ok=True)
    except FiptError as error:
        return _report_error(arguments, error)
    display = Display(sys.stdout, arguments.json, arguments.quiet)
    command = ["prepare", *options, "--", str(photographs), str(capture)]
    return _run_engine(arguments, command, capture / "log.txt", display.show)[0]


def _export(arguments: argparse.Namespace) -> int:
    import bpy

    from ..blend.export.exporting import export_room

    display = Display(sys.stdout, arguments.json, arguments.quiet)
    blend = arguments.blend.absolute()
    try:
        if not blend.is_file():
            raise FiptError("file-missing", f"{blend} does not exist.", "Give a .blend file with results.")
        try:
            bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False, use_scripts=False)
        except RuntimeError as error:
            text = f"{blend} can't be opened ({str(error).strip()})."
            raise FiptError("file-damaged", text, "Give a .blend file with results.") from None
        path, options = arguments.file.absolute(), (arguments.texture_size, arguments.lamp_lights)
        exported = export_room(bpy.context.scene, path, *options)
    except FiptError as error:
        return _report_error(arguments, error)
    for warning in exported.warnings:
        display.show(warning)
    display.show({"type": "done", "files": [str(exported.path)], "data": {"objects": exported.objects}})
    return 0


def _check(arguments: argparse.Namespace) -> int:
    display = Display(sys.stdout, arguments.json, arguments.quiet)

    def show(message: Message) -> None:
        display.show(message)
        if message["type"] == "done" and not arguments.json and not arguments.quiet:
            for name, value in message.get("data", {}).items():
                if isinstance(value, dict):
                    value = ", ".join(f"{key} {item or 'missing'}" for key, item in value.items())
                print(f"{name.replace('_', ' ')}: {'none' if value is None else value}")

    status, done = _run_engine(arguments, ["check"], Path(os.devnull), show)
    return status if status or (done and done["data"].get("ready", True)) else 1


def _run_engine(
    arguments: argparse.Namespace, command: list[str], log: Path, show: Callable[[Message], None]
) -> tuple[int, Message | None]:
    """Run one engine command; returns the exit status and its message `done`."""
    try:
        engine = find_launch(arguments.engine_python)
        process = EngineProcess(engine_command(engine.python, *command), log, engine.environment)
    except FiptError as error:
        return _report_error(arguments, error), None
    try:
        return (0 if process.run_blocking(show) else 1), process.done
    except KeyboardInterrupt:
        return 130, None


def _report_error(arguments: argparse.Namespace, error: FiptError) -> int:
    message = {"type": "error", "code": error.code, "text": error.text, "remedy": error.remedy}
    Display(sys.stdout, arguments.json, arguments.quiet).show(message)
    return 1
