# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture for what a scan lacks: find it, show what was found, draw a surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from .action import action
from .polls import has_meshes, has_views, in_object_mode, needs, no_job
from .views import checked_run, survey_steps

if TYPE_CHECKING:
    from ..bridge.sequence import Job

SHAPES = (
    ("BOX", "Box", "A box: a cabinet, a table, a mattress", "MESH_CUBE"),
    ("CYLINDER", "Cylinder", "A cylinder: a round table, a lamp's shade, a vase", "MESH_CYLINDER"),
    ("PANEL", "Panel", "A flat rectangle: a window pane, a mirror, a table top, a screen", "MESH_PLANE"),
)
PLACES = (
    (
        "DISAGREEMENT",
        "Where Photographs Disagree",
        "Where the photographs show most that the room lacks, if the views have been checked",
    ),
    ("CURSOR", "At 3D Cursor", "Standing at the 3D cursor"),
)


def _has_added(context: bpy.types.Context) -> bool:
    from ..blend.marks import ADDED

    return any(ADDED in item for item in context.scene.fipt.capture.room_objects(context.scene))


@action("Find Missing Surfaces", needs=(has_views, no_job))
def find_missing_surfaces(scene: bpy.types.Scene) -> Task:
    """Look now for what the photographs show and the scan lacks, as the estimation does, and add it to the
    room as objects that you may edit or delete. The estimation then adds nothing else. What was found before
    is replaced; what you have added stays. Takes minutes: use Check Views first, which is quick and tells
    whether the mesh fits the photographs.
    """

    def make(scene: bpy.types.Scene) -> Job:
        from ..api import estimating
        from ..bridge.step import Step
        from ..jobs.run_job import open_job, refuse_busy

        run = checked_run(scene)
        refuse_busy(run)
        run.create(estimating.scene_settings(scene))
        prepare, survey = survey_steps(run, search=True)
        command = ["complete", str(run.root)]
        search = Step("complete", "Looking for what the scan lacks", 60.0, command=command)
        return open_job(run, [prepare, search, survey], record="survey/steps.json")

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.additions import take_found
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)
        take_found(scene, run)

    return Task("Find Missing Surfaces", "completion", make, finished, undo=True)


@action(
    "Select Added Surfaces", needs=(needs(_has_added, "No surfaces were added to the room"), in_object_mode)
)
def select_added(context: bpy.types.Context) -> None:
    """Select the surfaces that were added to the room. Keep, edit or delete them: the estimation uses the
    room as it is.
    """
    from ..blend.capture.additions import added_surfaces
    from ..blend.outliner import select_only

    first, *others = [item for item in added_surfaces(context.scene) if not item.hide_get()] or [None]
    if first is None:
        raise FiptError("surfaces-hidden", "All added surfaces are hidden.", "Show them with Alt H.")
    select_only(context.view_layer, first)
    for item in others:
        item.select_set(True)


@action("Add Missing Surface", needs=(has_meshes, in_object_mode))
def add_surface(
    context: bpy.types.Context,
    shape: Annotated[str, Option("Shape of the solid", choices=SHAPES)] = "BOX",
    place: Annotated[str, Option("Where the solid goes", choices=PLACES)] = "DISAGREEMENT",
) -> str:
    """Add a simple solid to the room for a thing that the scan lacks: where the photographs show most after
    Check Views, otherwise at the 3D cursor. Move and scale it over the photographs. It is used as it is, not
    cleaned like a scan.
    """
    from ..blend.capture import additions
    from ..blend.outliner import select_only

    scene = context.scene
    where, text = None, iface_("Move and scale it until it covers the thing in the photographs")
    if place == "DISAGREEMENT" and scene.fipt.capture.unseen_share >= 0.0:
        where = additions.place_of_disagreement(scene)
        if where is None:  # in one report: the status bar shows the last one
            text = iface_("The photographs show nothing else: it is at the 3D cursor") + ". " + text
    where = where or additions.place_at(scene, scene.cursor.location)
    select_only(context.view_layer, additions.draw_surface(scene, shape, where))
    return text
