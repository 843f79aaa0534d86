# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Check: views rendered again beside their photographs, and the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder
from ..properties.check import PICTURES, VIEWS
from .job_operator import JobOperator
from .polls import has_run

if TYPE_CHECKING:
    from ..bridge.sequence import Job

VIEW_KEY = "fipt_view"


class RenderJob(JobOperator):
    """Mix-in of an operator that renders views of the room while that shows its estimated materials."""

    bl_options = {"REGISTER", "UNDO"}

    samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles' samples a pixel; 0 takes the panel's number",
        min=0,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context) or not has_run(cls, context):
            return False
        if context.scene.fipt.materials.shown != "ESTIMATED":
            cls.poll_message_set("Show the estimated materials first, in the section Materials")  # type: ignore[attr-defined]
            return False
        return True


def current_view(scene: bpy.types.Scene) -> str:
    """Name of the view through whose camera the scene looks.

    Raises:
        FiptError: ``view-missing``.
    """
    camera = scene.camera
    if camera is None or not camera.get(VIEW_KEY):
        raise FiptError(
            "view-missing",
            "The scene looks through no camera of the capture.",
            "Click a view in the section Capture.",
        )
    return str(camera[VIEW_KEY])


class FIPT_OT_render_views(RenderJob, bpy.types.Operator):
    """Render views of the estimated room in Cycles and compare them with their photographs; inserted objects
    and changed lights are left out"""

    bl_idname = "fipt.render_views"
    bl_label = "Render Views"
    title = "Check"
    kind = "check"

    which: bpy.props.EnumProperty(
        name="Views", description="Which views; the panel's choice if not given", items=VIEWS,
        options={"SKIP_SAVE"},
    )  # fmt: skip
    view: bpy.props.StringProperty(
        name="View", description="One view by its name instead", options={"SKIP_SAVE"}
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend import render_job

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        which = self.which if self.properties.is_property_set("which") else scene.fipt.check.which
        views = [self.view] if self.view else _chosen_views(scene, which)
        samples = self.samples or scene.fipt.check.samples
        return render_job.make_job(render_job.make_order(scene, run, render_job.CHECK, views, samples))

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.check_pictures import show_active, take_checks

        take_checks(scene, run)
        if not bpy.app.background and 0 <= scene.fipt.check.active < len(scene.fipt.check.views):
            show_active(scene, bpy.context)


def _chosen_views(scene: bpy.types.Scene, which: str) -> list[str]:
    """Names of the views to render.

    Raises:
        FiptError: ``view-missing``.
    """
    if which == "CURRENT":
        return [current_view(scene)]
    views = [view for view in scene.fipt.capture.views if view.enabled]
    names = [view.name for view in views if which == "TICKED" or view.split == "held_back"]
    if not names:
        text = "No view is ticked." if which == "TICKED" else "No ticked view is held back."
        raise FiptError("view-missing", text, "Tick views in the section Capture, or choose others here.")
    return names


class FIPT_OT_show_check(bpy.types.Operator):
    """Look through a checked view's camera at its photograph, its render or its error"""

    bl_idname = "fipt.show_check"
    bl_label = "Show Checked View"
    bl_options = {"REGISTER", "UNDO"}

    view: bpy.props.StringProperty(
        name="View", description="Name of the view; empty for the list's active one", options={"SKIP_SAVE"}
    )
    picture: bpy.props.EnumProperty(
        name="Picture", description="What to look at", items=PICTURES, options={"SKIP_SAVE"}
    )
    window: bpy.props.BoolProperty(
        name="Image Editor",
        description="Show it in an Image Editor too, in a window of its own if none is open",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.check.views:
            cls.poll_message_set("Render views first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.check_pictures import open_editor, show_active

        settings = context.scene.fipt.check
        index = settings.views.find(self.view) if self.view else settings.active
        if not 0 <= index < len(settings.views):
            self.report({"ERROR"}, f"The view '{self.view}' has not been rendered. Render it first.")
            return {"CANCELLED"}
        if self.properties.is_property_set("picture"):
            settings.picture = self.picture
        settings.active = index
        image = show_active(context.scene, context)
        if image is None:
            self.report({"ERROR"}, "The picture's file is missing. Render the view again.")
            return {"CANCELLED"}
        if self.window:
            open_editor(context, image)
        return {"FINISHED"}


class FIPT_OT_write_report(JobOperator, bpy.types.Operator):
    """Write a page that shows what was estimated: renders, maps, lights, warnings and settings"""

    bl_idname = "fipt.write_report"
    bl_label = "Write Report"
    title = "Report"
    kind = "report"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and has_run(cls, context)

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..bridge.step import Step
        from ..runjob import open_job

        run = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        run.read()  # explains a folder that is gone or holds something else
        step = Step("report", "Writing the report", 5.0, command=["report", str(run.root)])
        return open_job(run, [step], record="report/steps.json")

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        scene.fipt.check.report = str(run.report / "index.html")


class FIPT_OT_open_report(bpy.types.Operator):
    """Open the report in the web browser"""

    bl_idname = "fipt.open_report"
    bl_label = "Open Report"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.check.report:
            cls.poll_message_set("Write the report first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        page = Path(bpy.path.abspath(context.scene.fipt.check.report))
        if not page.is_file():
            self.report({"ERROR"}, f"{page} does not exist any more. Write the report again.")
            return {"CANCELLED"}
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


CLASSES = (FIPT_OT_render_views, FIPT_OT_show_check, FIPT_OT_write_report, FIPT_OT_open_report)
