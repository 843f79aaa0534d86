# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the panel Hints: say what is known of parts and areas, and estimate again with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying, estimating
from ..blend.marks import is_fixture
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..jobs import runstate
from ..jobs.tasks import Task
from ..properties.hints import ANSWERS, EMISSION
from .action import RowIndex, action, row_index
from .lights import LightName, find_light, own_lights
from .pointer import PicksAlongRay
from .polls import all_of, has_run, in_object_mode, needs, no_job
from .reporting import reports_errors

if TYPE_CHECKING:
    from mathutils import Vector


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
            raise FiptError("surface-missing", "There is no surface there.", "Click on the room.")
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


@action(
    "Hint on Selected Faces",
    needs=(
        needs(lambda context: context.mode == "EDIT_MESH", "Select the faces of the area in Edit Mode first"),
    ),
)
def add_area_hint(context: bpy.types.Context) -> None:
    """Say what the selected faces are made of; they become a part of their own."""
    from ..blend.hints.anchors import selected_faces, set_area
    from ..blend.hints.exchange import add_hint

    item = context.edit_object
    chosen = selected_faces(item)
    hint = add_hint(context.scene, f"{item.name} Area", item, item.matrix_world.translation)
    set_area(hint, item, chosen)


@action("Remove Hint", needs=(_has_hint,))
def remove_hint(
    scene: bpy.types.Scene,
    index: RowIndex = -1,
    every: Annotated[bool, Option("Remove all hints", "All")] = False,
) -> None:
    """Remove this hint, or all of them."""
    settings = scene.fipt.hints
    if every:
        settings.hints.clear()
    else:
        settings.hints.remove(row_index(settings.hints, index, settings.active_hint))
    settings.active_hint = max(min(settings.active_hint, len(settings.hints) - 1), 0)


@action("Find Doubtful Parts", needs=(has_run,))
def read_doubts(scene: bpy.types.Scene) -> str:
    """List the parts of the last estimate of which a hint would help most."""
    applying.show_doubts(scene, applying.run_of(scene))
    return iface_("{} questions").format(sum(not doubt.answered for doubt in scene.fipt.hints.doubts))


@action(
    "Answer",
    needs=(
        needs(lambda context: context.scene.fipt.hints.doubt() is not None, "Use Find Doubtful Parts first"),
    ),
)
def answer_doubt(
    scene: bpy.types.Scene,
    index: RowIndex = -1,
    answer: Annotated[str, Option("What the part is", choices=ANSWERS)] = "METAL",
) -> None:
    """Answer the question: makes a hint of it."""
    from ..blend.hints import exchange

    settings = scene.fipt.hints
    exchange.answer_doubt(scene, row_index(settings.doubts, index, settings.active_doubt), answer)


@action("Hint on Lamp", needs=own_lights)
def hint_on_lamp(
    scene: bpy.types.Scene,
    light: LightName = "",
    emission: Annotated[str, Option("Whether the fixture emits light", "Light", choices=EMISSION)] = "EMITS",
) -> None:
    """Say whether this is a lamp: makes a hint of it, which Estimate > Hints lists. It has an effect with
    Re-estimate with Hints, or the next Estimate.
    """
    from ..blend.hints import exchange

    lamp = find_light(scene, light)
    if not is_fixture(lamp):
        text = f"'{lamp.name}' is a light that was added, not estimated."
        raise FiptError("fixture-missing", text, "Select a fixture in the list of the section Lights.")
    exchange.hint_on_lamp(scene, lamp, emission)


@action(
    "Re-estimate with Hints",
    needs=(
        no_job,
        has_run,
        needs(lambda context: _state(context).continues, "Finish an estimate first"),
        in_object_mode,
    ),
)
def reestimate(scene: bpy.types.Scene) -> Task:
    """Estimate the materials again with the hints and apply them. The light that the last estimate has
    computed is kept, so that it takes about a minute. Estimate uses the hints from its beginning.
    """
    return estimating.reestimation()
