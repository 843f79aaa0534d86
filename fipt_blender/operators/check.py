# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Render: views rendered again beside their photographs, and the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..properties.check import PICTURES, VIEWS
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


class FIPT_OT_render_views(NeedsEstimate, JobOperator, bpy.types.Operator):
    bl_idname = "fipt.render_views"
    bl_label = "Render Views"
    bl_description = (
        "Render views of the estimated room in Cycles and compare them with their photographs. Inserted"
        " objects and changes to the lights are ignored"
    )
    bl_options = {"REGISTER", "UNDO"}
    title = "Render Views"
    kind = "check"

    samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles samples per pixel. If 0, the value in the panel is used",
        min=0,
        options={"SKIP_SAVE"},
    )
    which: bpy.props.EnumProperty(
        name="Views", description="Views to render. If not set, the choice in the panel is used", items=VIEWS,
        options={"SKIP_SAVE"},
    )  # fmt: skip
    view: bpy.props.StringProperty(
        name="View", description="Name of a single view to render instead", options={"SKIP_SAVE"}
    )

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.pictures.orders import make_order
        from ..blend.pictures.render_job import make_job

        scene = context.scene
        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        which = self.which if self.properties.is_property_set("which") else scene.fipt.check.which
        views = [self.view] if self.view else _chosen_views(scene, which)
        samples = self.samples or scene.fipt.check.samples
        return make_job(make_order(scene, run, views, samples))

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.pictures.check_pictures import show_active, take_checks

        take_checks(scene, run)
        if not bpy.app.background and 0 <= scene.fipt.check.active < len(scene.fipt.check.views):
            show_active(scene, bpy.context)


def _chosen_views(scene: bpy.types.Scene, which: str) -> list[str]:
    """Names of the views to render.

    Raises:
        FiptError: ``view-missing``.
    """
    if which == "CURRENT":
        from ..blend.pictures.orders import view_of

        return [view_of(scene.camera)]
    views = [view for view in scene.fipt.capture.views if view.enabled]
    names = [view.name for view in views if which == "TICKED" or view.split == "held_back"]
    if not names:
        text = "No view is ticked." if which == "TICKED" else "No ticked view is held back."
        raise FiptError(
            "view-missing",
            text,
            "Tick views in the section Capture, or choose other Views in the section Render.",
        )
    return names


class FIPT_OT_show_check(bpy.types.Operator):
    """Look through the camera of a rendered view at its photograph, render or error image"""

    bl_idname = "fipt.show_check"
    bl_label = "Show Rendered View"
    bl_options = {"REGISTER", "UNDO"}

    view: bpy.props.StringProperty(
        name="View",
        description="Name of the view. If empty, the active view of the list is used",
        options={"SKIP_SAVE"},
    )
    picture: bpy.props.EnumProperty(
        name="Picture", description="Image to show", items=PICTURES, options={"SKIP_SAVE"}
    )
    window: bpy.props.BoolProperty(
        name="Image Editor",
        description="Show the picture in an Image Editor as well; opens a new window if there is none",
        options={"SKIP_SAVE"},
    )

    poll = all_of(needs(lambda context: context.scene.fipt.check.views, "Use Render Views first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.pictures.check_pictures import open_editor, show_active

        settings = context.scene.fipt.check
        index = settings.views.find(self.view) if self.view else settings.active
        if not 0 <= index < len(settings.views):
            self.report({"ERROR"}, f"The view '{self.view}' has not been rendered. Use Render Views first.")
            return {"CANCELLED"}
        if self.properties.is_property_set("picture"):
            settings.picture = self.picture
        settings.active = index
        image = show_active(context.scene, context)
        if image is None:
            self.report({"ERROR"}, "The image file is missing. Render the view again.")
            return {"CANCELLED"}
        if self.window:
            open_editor(context, image)
        return {"FINISHED"}


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
