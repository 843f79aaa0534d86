# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture for its list of views: look through, tick, check, show coverage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import bpy

from .. import machine
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from .action import REGISTER, action
from .polls import has_views, no_job, views_checked

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices, Step

TICKS = (
    ("ALL", "All", "Use every view"),
    ("NONE", "None", "Use no view"),
    ("INVERT", "Invert", "Use the views that are not used now, and only these"),
    ("GOOD", "Without Warnings", "Use the views for which Check Views gave no warning"),
)


@action("Look Through View", needs=(has_views,))
def look_through(
    context: bpy.types.Context,
    view: Annotated[str, "Name of the view. If empty, the active view of the list is used"] = "",
    step: Annotated[int, Option("1 for the next view in the list, -1 for the previous one", low=-1)] = 0,
    toggle: Annotated[
        bool,
        Option("Also show the photograph over the view, or hide it if it is shown", "Toggle Photograph"),
    ] = False,
) -> None:
    """Look through the camera of a view."""
    from ..blend.capture import look

    settings = context.scene.fipt.capture
    index = settings.active_view
    if view:
        index = settings.views.find(view)
        if index < 0:
            raise FiptError("view-missing", f"There is no view '{view}'.", "Use the name of one in the list.")
    index = (index + step) % len(settings.views)
    if toggle:
        shown = look.shows_photograph(context.scene, settings.views[index], context)
        setattr(settings, settings.photograph_switch(), not shown)
    if look.look_through(context.scene, settings.views[index], context) is None:
        raise look.camera_missing(settings.views[index])
    settings.active_view = index


@action("Tick Views", needs=(has_views,))
def tick_views(
    scene: bpy.types.Scene, action: Annotated[str, Option("Views to tick", choices=TICKS)] = "ALL"
) -> None:
    """Tick all views in the list, none, the other ones, or those without warnings."""
    settings = scene.fipt.capture
    with settings.counting_later():
        for view in settings.views:
            view.enabled = {
                "ALL": True,
                "NONE": False,
                "INVERT": not view.enabled,
                "GOOD": not view.warning,
            }[action]
    settings.count_views()


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


def checked_run(scene: bpy.types.Scene) -> RunFolder:
    """The scene's run folder, for work on its room and views.

    Raises:
        FiptError: ``room-missing``.
    """
    from ..blend.capture.importing import room_missing

    if not scene.fipt.capture.room_objects(scene):
        raise room_missing()
    return RunFolder(bpy.path.abspath(scene.fipt.run_folder))


@action("Check Views", needs=(has_views, no_job), options=REGISTER)
def check_views(scene: bpy.types.Scene) -> Task:
    """Check what each view sees of the room and whether its photograph is usable, and find the parts."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs.run_job import open_job

        run = checked_run(scene)
        return open_job(run, list(survey_steps(run)), record="survey/steps.json")

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)

    return Task("Check Views", "survey", make, finished)


@action("Show Coverage", needs=(views_checked,), options=REGISTER)
def show_coverage(scene: bpy.types.Scene, show: Annotated[bool, "Show or hide the colors"] = True) -> None:
    """Color the room by the number of ticked views that see each surface."""
    from ..blend.capture import overlay, survey

    survey.show_coverage(scene) if show else overlay.hide()
