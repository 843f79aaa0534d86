"""Operators of the panel Hints: say what is known of parts and areas, and estimate again with it."""

from __future__ import annotations

from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_
from mathutils import Vector

from ..api import applying, estimating
from ..blend.marks import is_fixture
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..jobs.tasks import Task
from ..properties.hints import ANSWERS, EMISSION
from .action import RowIndex, action, row_index
from .lights import LightName, find_light, own_lights
from .pointer import PicksAlongRay, PointerRay
from .polls import has_run, in_object_mode, needs, no_job, run_state

_in_room_mode = needs(lambda context: context.mode in ("OBJECT", "SCULPT"), "Switch to Object Mode first")
_has_hint = needs(lambda context: context.scene.fipt.hints.hint() is not None, "Add a hint first")


ABOUT = (
    ("PART", "Part", "The part of the room that you click", "EYEDROPPER"),
    ("FACE_SET", "Face Set", "The painted face set that you click, as a part of its own", "FACE_MAPS"),
)


def _clicked(context: bpy.types.Context, ray: PointerRay) -> tuple[bpy.types.Object, int, Vector]:
    """The object on a ray, its polygon, and the point in the world."""
    from ..blend.ray_hits import surface_on_ray

    found = surface_on_ray(context.scene, context.evaluated_depsgraph_get(), *ray)
    if found is None:
        raise FiptError("surface-missing.clicked")
    if context.area is not None:
        context.area.tag_redraw()
    return found


@action(
    "Add Hint",
    needs=(_in_room_mode,),
    bases=(PicksAlongRay,),
    pick_text="Click: Choose the Part   Esc, Right Click: Cancel",
)
def add_hint(
    context: bpy.types.Context,
    ray: PointerRay,
    what: Annotated[str, Option("What the hint is about", "About", choices=ABOUT)] = "PART",
) -> None:
    """Click on a part of the room, or on a face set, to say what it is made of."""
    from ..blend.hints import exchange
    from ..blend.hints.anchors import face_set_at, set_area

    item, face, point = _clicked(context, ray)
    chosen = face_set_at(item, face) if what == "FACE_SET" else None
    hint = exchange.add_hint(context.scene, item.name, item, point)
    if chosen is not None:
        set_area(hint, item, chosen)


@action(
    "Same Material As",
    needs=(_has_hint, _in_room_mode),
    bases=(PicksAlongRay,),
    pick_text="Click: Choose the Part of the Same Material   Esc, Right Click: Cancel",
)
def pick_same_material(context: bpy.types.Context, ray: PointerRay) -> None:
    """Click on a part that is of the same material as the active hint's."""
    item, _, point = _clicked(context, ray)
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


@action("Remove Hint", needs=(_has_hint,), listed=False)
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
    listed=False,
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


@action("Hint on Lamp", needs=own_lights, listed=False)
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
        raise FiptError("fixture-missing.hint-on-lamp", name=lamp.name)
    exchange.hint_on_lamp(scene, lamp, emission)


@action(
    "Re-estimate with Hints",
    needs=(
        no_job,
        has_run,
        needs(lambda context: run_state(context).results, "Finish an estimate first"),
        in_object_mode,
    ),
)
def reestimate(scene: bpy.types.Scene) -> Task:
    """Estimate the materials again with the hints and apply them. The light that the last estimate has
    computed is kept, so that it takes about a minute; what a stopped one has replaced is done again. Estimate
    uses the hints from its beginning.
    """
    return estimating.reestimation()
