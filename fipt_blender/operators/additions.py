# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Capture for what a scan lacks: find it, show what was found, draw a surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.runfolder import RunFolder
from .polls import all_of, has_meshes, in_object_mode, needs
from .reporting import reports_errors
from .views import SurveyJob, survey_steps

if TYPE_CHECKING:
    from ..bridge.sequence import Job

SHAPES = (
    ("BOX", "Box", "A box: a cabinet, a table, a mattress", "MESH_CUBE", 0),
    ("CYLINDER", "Cylinder", "A cylinder: a round table, a lamp's shade, a vase", "MESH_CYLINDER", 1),
    ("PANEL", "Panel", "A flat rectangle: a window pane, a mirror, a table top, a screen", "MESH_PLANE", 2),
)


def _has_added(context: bpy.types.Context) -> bool:
    from ..blend.marks import ADDED

    return any(ADDED in item for item in context.scene.fipt.capture.room_objects(context.scene))


class FIPT_OT_find_missing_surfaces(SurveyJob, bpy.types.Operator):
    """Look for what the photographs show and the scan lacks, and add it to the room"""

    bl_idname = "fipt.find_missing_surfaces"
    bl_label = "Find Missing Surfaces"
    bl_description = (
        "Look now for what the photographs show and the scan lacks, as the estimation does, and add it to the"
        " room as objects that you may edit or delete. The estimation then adds nothing else. What was found"
        " before is replaced; what you have added stays. Takes minutes: use Check Views first, which is quick"
        " and tells whether the mesh fits the photographs"
    )
    bl_options = {"REGISTER", "UNDO"}
    title = "Find Missing Surfaces"
    kind = "completion"

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..api import estimating
        from ..bridge.step import Step
        from ..jobs.run_job import open_job, refuse_busy

        run = self.checked_run(context)
        refuse_busy(run)
        run.create(estimating.scene_settings(context.scene))
        prepare, survey = survey_steps(run, search=True)
        search = Step(
            "complete", "Looking for what the scan lacks", 60.0, command=["complete", str(run.root)]
        )
        return open_job(run, [prepare, search, survey], record="survey/steps.json")

    @staticmethod
    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.additions import take_found
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)
        take_found(scene, run)


class FIPT_OT_select_added(bpy.types.Operator):
    """Select the surfaces that were added to the room"""

    bl_idname = "fipt.select_added"
    bl_label = "Select Added Surfaces"
    bl_description = (
        "Select the surfaces that were added to the room. Keep, edit or delete them: the estimation uses the"
        " room as it is"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(needs(_has_added, "No surfaces were added to the room"), in_object_mode)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.additions import added_surfaces
        from ..blend.outliner import select_only

        first, *others = [item for item in added_surfaces(context.scene) if not item.hide_get()] or [None]
        if first is None:
            self.report({"ERROR"}, "All added surfaces are hidden. Show them with Alt H.")
            return {"CANCELLED"}
        select_only(context.view_layer, first)
        for item in others:
            item.select_set(True)
        return {"FINISHED"}


class FIPT_OT_add_surface(bpy.types.Operator):
    """Add a simple solid to the room for a thing that the scan lacks"""

    bl_idname = "fipt.add_surface"
    bl_label = "Add Missing Surface"
    bl_description = (
        "Add a simple solid to the room for a thing that the scan lacks: where the photographs show most"
        " after Check Views, otherwise at the 3D cursor. Move and scale it over the photographs. It is used"
        " as it is, not cleaned like a scan"
    )
    bl_options = {"REGISTER", "UNDO"}

    shape: bpy.props.EnumProperty(name="Shape", description="Shape of the solid", items=SHAPES)
    place: bpy.props.EnumProperty(
        name="Place",
        description="Where the solid goes",
        items=[
            (
                "DISAGREEMENT",
                "Where Photographs Disagree",
                "Where the photographs show most that the room lacks, if the views have been checked",
            ),
            ("CURSOR", "At 3D Cursor", "Standing at the 3D cursor"),
        ],
    )

    poll = all_of(has_meshes, in_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture import additions
        from ..blend.outliner import select_only

        scene = context.scene
        place, text = None, iface_("Move and scale it until it covers the thing in the photographs")
        if self.place == "DISAGREEMENT" and scene.fipt.capture.unseen_share >= 0.0:
            place = additions.place_of_disagreement(scene)
            if place is None:  # in one report: the status bar shows the last one
                text = iface_("The photographs show nothing else: it is at the 3D cursor") + ". " + text
        place = place or additions.place_at(scene, scene.cursor.location)
        select_only(context.view_layer, additions.draw_surface(scene, self.shape, place))
        self.report({"INFO"}, text)
        return {"FINISHED"}
