# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panel Hints: say what is known of parts and areas, and estimate again with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying, estimating
from ..blend.marks import is_fixture
from ..core.run.errors import FiptError
from ..jobs import runstate
from ..properties.hints import ANSWERS, EMISSION
from .job_operator import JobOperator
from .lights import NeedsLights, find_light, light_name_property
from .pointer import PicksAlongRay
from .polls import all_of, has_run, in_object_mode, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from mathutils import Vector

    from ..jobs.tasks import Task


def _state(context: bpy.types.Context) -> runstate.RunState:
    return runstate.known(context.scene.fipt.run_folder)


_in_room_mode = needs(lambda context: context.mode in ("OBJECT", "SCULPT"), "Switch to Object Mode first")
_has_hint = needs(lambda context: context.scene.fipt.hints.hint() is not None, "Add a hint first")


class _PicksSurface(PicksAlongRay):
    """Mix-in of an operator that does something at the surface that the user clicks."""

    poll = all_of(_in_room_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.hints.anchors import surface_on_ray

        found = surface_on_ray(context.scene, context.evaluated_depsgraph_get(), *self.ray())
        if found is None:
            self.report({"WARNING"}, "There is no surface there")  # type: ignore[attr-defined]
            return {"CANCELLED"}
        self.use(context, *found)
        if context.area is not None:
            context.area.tag_redraw()
        return {"FINISHED"}

    def use(self, context: bpy.types.Context, item: bpy.types.Object, face: int, point: Vector) -> None:
        """Do it at a point of a polygon of an object."""
        raise NotImplementedError


class FIPT_OT_add_hint(_PicksSurface, bpy.types.Operator):
    bl_idname = "fipt.add_hint"
    bl_label = "Add Hint"
    bl_description = "Click on a part of the room, or on a face set, to say what it is made of"
    bl_options = {"REGISTER", "UNDO"}
    pick_text = "Click: Choose the Part   Esc, Right Click: Cancel"

    what: bpy.props.EnumProperty(
        name="About",
        description="What the hint is about",
        items=[
            ("PART", "Part", "The part of the room that you click", "EYEDROPPER", 0),
            (
                "FACE_SET",
                "Face Set",
                "The painted face set that you click, as a part of its own",
                "FACE_MAPS",
                1,
            ),
        ],
        options={"SKIP_SAVE"},
    )

    def use(self, context: bpy.types.Context, item: bpy.types.Object, face: int, point: Vector) -> None:
        from ..blend.hints.anchors import face_set_at, set_area
        from ..blend.hints.exchange import add_hint

        chosen = face_set_at(item, face) if self.what == "FACE_SET" else None
        hint = add_hint(context.scene, item.name, item, point)
        if chosen is not None:
            set_area(hint, item, chosen)


class FIPT_OT_add_area_hint(bpy.types.Operator):
    """Say what the selected faces are made of; they become a part of their own"""

    bl_idname = "fipt.add_area_hint"
    bl_label = "Hint on Selected Faces"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        needs(lambda context: context.mode == "EDIT_MESH", "Select the faces of the area in Edit Mode first")
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.hints.anchors import selected_faces, set_area
        from ..blend.hints.exchange import add_hint

        item = context.edit_object
        chosen = selected_faces(item)
        set_area(
            add_hint(context.scene, f"{item.name} Area", item, item.matrix_world.translation), item, chosen
        )
        return {"FINISHED"}


class FIPT_OT_pick_same_material(_PicksSurface, bpy.types.Operator):
    """Click on a part that is of the same material as the active hint's"""

    bl_idname = "fipt.pick_same_material"
    bl_label = "Same Material As"
    bl_options = {"REGISTER", "UNDO"}
    pick_text = "Click: Choose the Part of the Same Material   Esc, Right Click: Cancel"

    poll = all_of(_has_hint, _in_room_mode)

    def use(self, context: bpy.types.Context, item: bpy.types.Object, face: int, point: Vector) -> None:
        hint = context.scene.fipt.hints.hint()
        hint.same_object, hint.same_point = item, item.matrix_world.inverted_safe() @ point


class FIPT_OT_remove_hint(bpy.types.Operator):
    """Remove this hint, or all of them"""

    bl_idname = "fipt.remove_hint"
    bl_label = "Remove Hint"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty(
        name="Index",
        description="Number of the hint in the list, from 0; the active one if negative",
        default=-1,
    )
    every: bpy.props.BoolProperty(name="All", description="Remove all hints", options={"SKIP_SAVE"})

    poll = all_of(_has_hint)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.fipt.hints
        if self.every:
            settings.hints.clear()
        else:
            index = settings.active_hint if self.index < 0 else self.index
            if index >= len(settings.hints):
                self.report({"ERROR"}, f"There is no hint {index}. The list has {len(settings.hints)}.")
                return {"CANCELLED"}
            settings.hints.remove(index)
        settings.active_hint = max(min(settings.active_hint, len(settings.hints) - 1), 0)
        return {"FINISHED"}


class FIPT_OT_read_doubts(bpy.types.Operator):
    """List the parts of the last estimate of which a hint would help most"""

    bl_idname = "fipt.read_doubts"
    bl_label = "Find Doubtful Parts"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(has_run)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        applying.show_doubts(context.scene, applying.run_of(context.scene))
        open_ones = sum(not doubt.answered for doubt in context.scene.fipt.hints.doubts)
        self.report({"INFO"}, iface_("{} questions").format(open_ones))
        return {"FINISHED"}


class FIPT_OT_answer_doubt(bpy.types.Operator):
    """Answer the question: makes a hint of it"""

    bl_idname = "fipt.answer_doubt"
    bl_label = "Answer"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty(
        name="Index",
        description="Number of the question in the list, from 0; the active one if negative",
        default=-1,
    )
    answer: bpy.props.EnumProperty(name="Answer", description="What the part is", items=ANSWERS)

    poll = all_of(
        needs(lambda context: context.scene.fipt.hints.doubt() is not None, "Use Find Doubtful Parts first")
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.hints.exchange import answer_doubt

        settings = context.scene.fipt.hints
        index = settings.active_doubt if self.index < 0 else self.index
        if index >= len(settings.doubts):
            self.report({"ERROR"}, f"There is no question {index}. The list has {len(settings.doubts)}.")
            return {"CANCELLED"}
        answer_doubt(context.scene, index, self.answer)
        return {"FINISHED"}


class FIPT_OT_hint_on_lamp(NeedsLights, bpy.types.Operator):
    bl_idname = "fipt.hint_on_lamp"
    bl_label = "Hint on Lamp"
    bl_description = (
        "Say whether this is a lamp: makes a hint of it, which Estimate > Hints lists. It has an effect with"
        " Re-estimate with Hints, or the next Estimate"
    )
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("fixture")
    emission: bpy.props.EnumProperty(
        name="Light", description="Whether the fixture emits light", items=EMISSION, default="EMITS"
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.hints.exchange import hint_on_lamp

        lamp = find_light(context.scene, self.light)
        if not is_fixture(lamp):
            text = f"'{lamp.name}' is a light that was added, not estimated."
            raise FiptError("fixture-missing", text, "Select a fixture in the list of the section Lights.")
        hint_on_lamp(context.scene, lamp, self.emission)
        return {"FINISHED"}


class FIPT_OT_reestimate(JobOperator, bpy.types.Operator):
    bl_idname = "fipt.reestimate"
    bl_label = "Re-estimate with Hints"
    bl_description = (
        "Estimate the materials again with the hints and apply them. The light that the last estimate has"
        " computed is kept, so that it takes about a minute. Estimate uses the hints from its beginning"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        no_job,
        has_run,
        needs(lambda context: _state(context).continues, "Finish an estimate first"),
        in_object_mode,
    )

    def task(self, context: bpy.types.Context) -> Task:
        return estimating.reestimation()
