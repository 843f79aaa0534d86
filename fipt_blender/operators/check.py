# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Render: the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from .action import REGISTER, action
from .polls import has_run, needs, no_job

if TYPE_CHECKING:
    from ..bridge.sequence import Job


@action("Write Report", needs=(no_job, has_run), options=REGISTER)
def write_report(scene: bpy.types.Scene) -> Task:
    """Write an HTML page that shows the results: renders, maps, lights, warnings and settings."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..bridge.step import Step
        from ..jobs.run_job import open_job

        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        run.read()  # raises if the folder is missing or no run folder
        step = Step("report", "Writing the report", 5.0, command=["report", str(run.root)])
        return open_job(run, [step], record="report/steps.json")

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        scene.fipt.check.report = str(run.report / "index.html")

    return Task("Write Report", "report", make, finished)


@action(
    "Open Report",
    needs=(needs(lambda context: context.scene.fipt.check.report, "Use Write Report first"),),
    options=REGISTER,
)
def open_report(scene: bpy.types.Scene) -> None:
    """Open the report in the web browser."""
    # The path comes from the .blend file, whoever made that.
    page = Path(bpy.path.abspath(scene.fipt.check.report))
    run = RunFolder(page.parent.parent)
    if page != run.report / "index.html" or not run.run_json.is_file():
        raise FiptError("report-missing", f"{page} is not the report of a run.", "Write the report again.")
    if not page.is_file():
        raise FiptError("report-missing", f"{page} no longer exists.", "Write the report again.")
    bpy.ops.wm.url_open(url=page.as_uri())
