# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Render: the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.runfolder import RunFolder
from .job_operator import JobOperator
from .polls import all_of, has_run, needs, no_job

if TYPE_CHECKING:
    from ..bridge.sequence import Job


class NeedsEstimate:
    """Mix-in of an operator that renders the room, which must show its estimated materials."""

    poll = all_of(
        no_job,
        has_run,
        needs(
            lambda context: context.scene.fipt.materials.shown == "ESTIMATED",
            "Set Show to Estimated first, in the section Materials",
        ),
    )


class FIPT_OT_write_report(JobOperator, bpy.types.Operator):
    """Write an HTML page that shows the results: renders, maps, lights, warnings and settings"""

    bl_idname = "fipt.write_report"
    bl_label = "Write Report"
    title = "Write Report"
    kind = "report"

    poll = all_of(no_job, has_run)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..bridge.step import Step
        from ..jobs.run_job import open_job

        run = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        run.read()  # raises if the folder is missing or no run folder
        step = Step("report", "Writing the report", 5.0, command=["report", str(run.root)])
        return open_job(run, [step], record="report/steps.json")

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        scene.fipt.check.report = str(run.report / "index.html")


class FIPT_OT_open_report(bpy.types.Operator):
    """Open the report in the web browser"""

    bl_idname = "fipt.open_report"
    bl_label = "Open Report"

    poll = all_of(needs(lambda context: context.scene.fipt.check.report, "Use Write Report first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        # The path comes from the .blend file, whoever made that.
        page = Path(bpy.path.abspath(context.scene.fipt.check.report))
        run = RunFolder(page.parent.parent)
        if page != run.report / "index.html" or not run.run_json.is_file():
            self.report({"ERROR"}, f"{page} is not the report of a run. Write the report again.")
            return {"CANCELLED"}
        if not page.is_file():
            self.report({"ERROR"}, f"{page} no longer exists. Write the report again.")
            return {"CANCELLED"}
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}
