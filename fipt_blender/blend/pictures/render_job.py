# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Carries out orders of renders as jobs: in a second Blender on a copy of the open file, so that the window
stays responsive; in background in the same Blender.

The copy and its order (a small JSON) lie in the run folder.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import bpy

from ...bridge.interpreter import PACKAGE_FOLDER
from ...bridge.job import Job
from ...bridge.process import EngineProcess, Message
from ...bridge.step import Step
from ...core.run.errors import FiptError
from ...core.run.messages import Reporter, claim_stdout
from ...core.run.runfolder import RunFolder, write_json
from ..save import write_error
from .cycles import enable_devices
from .orders import COMPOSITE, Order, carry_out
from .renders import Progress

_FOLDER = ".job"
# Imports the package from its folder, since the extension is not enabled in the second Blender.
_START = """
import importlib.util, sys
folder = {folder!r}
spec = importlib.util.spec_from_file_location(
    "fipt_blender", folder + "/__init__.py", submodule_search_locations=[folder])
package = importlib.util.module_from_spec(spec)
sys.modules["fipt_blender"] = package
spec.loader.exec_module(package)
importlib.import_module("fipt_blender.blend.pictures.render_job").child({order!r})
"""


def make_job(order: Order) -> Job:
    """The order as a job: in a second Blender where there is a window, else in this one."""
    run = RunFolder(order.run)
    in_second_blender = not bpy.app.background and bool(bpy.app.binary_path)
    steps = _steps_in_second_blender(order, run) if in_second_blender else [_step_here(order)]
    return Job(steps, run.log)


def _seconds(order: Order) -> float:
    return 10.0 * (2 if order.kind == COMPOSITE else 1)


def _step_here(order: Order) -> Step:
    def function() -> list[Message]:
        return carry_out(order)

    return Step("render", order.title, _seconds(order), function=function)


def _steps_in_second_blender(order: Order, run: RunFolder) -> list[Step]:
    folder = run.renders / _FOLDER
    blend, order_json = folder / "scene.blend", folder / "order.json"

    def save() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        write_json(order_json, asdict(order))
        try:
            bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, check_existing=False, compress=False)
        except RuntimeError as error:
            raise write_error(blend, error, "blend-unwritable") from None

    def start() -> EngineProcess:
        return EngineProcess(child_command(blend, order_json), run.log, None, run.messages("render"))

    return [
        Step("copy", "Copying the scene", 1.0, function=save),
        Step("render", order.title, _seconds(order), process=start),
    ]


def child_command(blend: Path, order: Path) -> list[str]:
    """The command line of the second Blender."""
    scripts = bpy.context.preferences.filepaths.use_scripts_auto_execute
    return [
        bpy.app.binary_path,
        "--background",
        "--factory-startup",
        "--enable-autoexec" if scripts else "--disable-autoexec",
        str(blend),
        "--python-expr",
        _START.format(folder=str(PACKAGE_FOLDER), order=str(order)),
    ]


def child(path: str) -> None:
    """Carry out an order in the second Blender and end that; messages go to stdout."""
    reporter = Reporter(claim_stdout())
    with open(os.devnull, "wb") as devnull:  # Cycles prints a line for every sample
        os.dup2(devnull.fileno(), 1)
    status = 1
    try:
        order = Order(**json.loads(Path(path).read_text(encoding="utf-8")))
        enable_devices(order.devices)
        reporter.plan([1.0])
        reporter.stage("render", order.title)
        with _sample_progress(reporter) as progress:
            for warning in carry_out(order, progress):
                reporter.warning(warning["code"], warning["text"], warning["remedy"])
        reporter.progress(1.0, force=True)
        reporter.done([])
        status = 0
    except FiptError as error:
        reporter.error(error.code, error.text, error.remedy)
    except Exception as error:
        traceback.print_exc()
        reporter.error(
            "render-failed", f"The render failed ({error}).", "log.txt in the run folder has details."
        )
    finally:
        shutil.rmtree(Path(path).parent, ignore_errors=True)
    sys.stderr.flush()
    os._exit(status)


@contextmanager
def _sample_progress(reporter: Reporter) -> Iterator[Progress]:
    """Report the progress of each render by its samples."""
    start, end = 0.0, 0.0

    def begin(low: float, high: float) -> None:
        nonlocal start, end
        start, end = low, high
        reporter.progress(start, force=True)

    def follow(text: object, *_: object) -> None:
        match = re.search(r"Sample (\d+)/(\d+)", str(text))
        if match:
            share = int(match[1]) / max(int(match[2]), 1)
            reporter.progress(start + share * (end - start))

    bpy.app.handlers.render_stats.append(follow)
    try:
        yield begin
    finally:
        bpy.app.handlers.render_stats.remove(follow)
