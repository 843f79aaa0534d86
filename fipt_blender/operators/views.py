# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture for its list of views: look through, tick, check, show coverage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from .. import machine
from ..core.run.runfolder import RunFolder
from .job_operator import JobOperator
from .overlay import ShowsColors
from .polls import all_of, has_views, no_job, views_checked
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step


class FIPT_OT_look_through(bpy.types.Operator):
    """Look through the camera of a view"""

    bl_idname = "fipt.look_through"
    bl_label = "Look Through View"
    bl_options = {"REGISTER", "UNDO"}

    view: bpy.props.StringProperty(
        name="View",
        description="Name of the view. If empty, the active view of the list is used",
        options={"SKIP_SAVE"},
    )
    step: bpy.props.IntProperty(
        name="Step",
        description="1 for the next view in the list, -1 for the previous one",
        options={"SKIP_SAVE"},
    )

    toggle: bpy.props.BoolProperty(
        name="Toggle Photograph",
        description="Also show the photograph over the view, or hide it if it is shown",
        options={"SKIP_SAVE"},
    )

    poll = all_of(has_views)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.look import camera_missing, look_through, shows_photograph

        settings = context.scene.fipt.capture
        index = settings.active_view
        if self.view:
            index = settings.views.find(self.view)
            if index < 0:
                self.report({"ERROR"}, f"There is no view '{self.view}'. Use the name of a view in the list.")
                return {"CANCELLED"}
        index = (index + self.step) % len(settings.views)
        if self.toggle:
            shown = shows_photograph(context.scene, settings.views[index], context)
            setattr(settings, settings.photograph_switch(), not shown)
        if look_through(context.scene, settings.views[index], context) is None:
            raise camera_missing(settings.views[index])
        settings.active_view = index
        return {"FINISHED"}


class FIPT_OT_tick_views(bpy.types.Operator):
    """Tick all views in the list, none, the other ones, or those without warnings"""

    bl_idname = "fipt.tick_views"
    bl_label = "Tick Views"
    bl_options = {"REGISTER", "UNDO"}

    action: bpy.props.EnumProperty(
        name="Action",
        description="Views to tick",
        items=[
            ("ALL", "All", "Use every view"),
            ("NONE", "None", "Use no view"),
            ("INVERT", "Invert", "Use the views that are not used now, and only these"),
            ("GOOD", "Without Warnings", "Use the views for which Check Views gave no warning"),
        ],
    )

    poll = all_of(has_views)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.fipt.capture
        with settings.counting_later():
            for view in settings.views:
                view.enabled = {
                    "ALL": True,
                    "NONE": False,
                    "INVERT": not view.enabled,
                    "GOOD": not view.warning,
                }[self.action]
        settings.count_views()
        return {"FINISHED"}


def survey_steps(run: RunFolder, search: bool = False) -> tuple[Step, Step]:
    """The steps that write the input of the engine's survey and that do it.

    Args:
        search: the input is for a search of what the room lacks.
    """
    from ..bridge.step import Step

    def write_input() -> Slices[list[Message]]:
        from ..blend.capture.survey import write_survey_input

        return write_survey_input(run, search)

    return (
        Step("survey-input", "Preparing the room", 3.0, function=write_input, repeat=True),
        Step(
            "survey",
            "Finding what each camera sees",
            10.0,
            command=["survey", str(run.survey), f"--device={machine.device_setting()}"],
            outputs=[run.survey_json, run.survey_npz],
        ),
    )


class SurveyJob(JobOperator):
    """Base of the operators that examine the scene's room and views."""

    poll = all_of(has_views, no_job)

    @staticmethod
    def checked_run(context: bpy.types.Context) -> RunFolder:
        """The scene's run folder.

        Raises:
            FiptError: ``room-missing``.
        """
        from ..blend.capture.importing import room_missing

        scene = context.scene
        if not scene.fipt.capture.room_objects(scene):
            raise room_missing()
        return RunFolder(bpy.path.abspath(scene.fipt.run_folder))


class FIPT_OT_check_views(SurveyJob, bpy.types.Operator):
    """Check what each view sees of the room and whether its photograph is usable, and find the parts"""

    bl_idname = "fipt.check_views"
    bl_label = "Check Views"
    bl_options = {"REGISTER"}
    title = "Check Views"
    kind = "survey"

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..jobs.run_job import open_job

        run = self.checked_run(context)
        return open_job(run, list(survey_steps(run)), record="survey/steps.json")

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)


class FIPT_OT_show_coverage(ShowsColors, bpy.types.Operator):
    """Color the room by the number of ticked views that see each surface"""

    bl_idname = "fipt.show_coverage"
    bl_label = "Show Coverage"

    poll = all_of(views_checked)

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        from ..blend.capture.survey import show_coverage

        show_coverage(scene)
