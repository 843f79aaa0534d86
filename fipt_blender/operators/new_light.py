"""Operators of the section Lights that add lights and aim them."""

from __future__ import annotations

from typing import Annotated

import bpy
from mathutils import Matrix, Vector

from ..blend.marks import NEW_LIGHT
from ..core.run.declared import Option
from .action import action
from .pointer import DOWN, ORIGIN, PicksInViewport, Point, surface_under_pointer
from .polls import in_object_mode, needs

_PICK_TEXT = "Click: Point the new light at this surface   Esc, Right Click: Cancel"


PLACES = (
    ("CURSOR", "At 3D Cursor", "At the 3D cursor, shining down", "CURSOR"),
    ("PICK", "Pointing at Click", "Pointing at the surface that you click", "RESTRICT_SELECT_OFF"),
)


class _PicksTarget(PicksInViewport):
    """Base of an action on a place, a direction, a size and a power, which the click or the room tell."""

    text_in_header = True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.new_lights import suggest

        suggestion, values = suggest(context.scene), self.properties
        if not values.is_property_set("location"):
            values.location = context.scene.cursor.location
        values.size, values.power = values.size or suggestion.size, values.power or suggestion.watts
        return self.run(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.place == "CURSOR" or self.properties.is_property_set("location"):
            return self.execute(context)
        if not self.is_in_viewport(context):
            return {"CANCELLED"}
        return self.wait_for_clicks(context, _PICK_TEXT)

    def take_click(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        from ..blend.lights.new_lights import aim, suggest

        surface = surface_under_pointer(context, event)
        if surface is None:
            self.report({"WARNING"}, "There is no surface under the mouse pointer")
            return False
        self.location, self.direction = aim(
            context.scene,
            context.evaluated_depsgraph_get(),
            surface.position,
            surface.normal,
            suggest(context.scene).distance,
        )
        return True


@action("Add Light", needs=(in_object_mode,), bases=(_PicksTarget,))
def add_light(
    context: bpy.types.Context,
    place: Annotated[str, Option("Where the light goes", choices=PLACES)] = "CURSOR",
    location: Annotated[
        Point,
        Option(
            "Center of the light, in world space. If not set, the 3D cursor is used",
            shown={"subtype": "TRANSLATION"},
        ),
    ] = ORIGIN,
    direction: Annotated[
        Point, Option("Direction in which the light shines, in world space", shown={"subtype": "XYZ"})
    ] = DOWN,
    size: Annotated[
        float,
        Option(
            "Side of the square light. If 0, it is chosen to suit the room",
            zero=True,
            shown={"subtype": "DISTANCE"},
        ),
    ] = 0.0,
    power: Annotated[
        float,
        Option(
            "Power in watts. If 0, the room becomes about as bright as in its photographs",
            zero=True,
            shown={"subtype": "POWER"},
        ),
    ] = 0.0,
) -> None:
    """Add an area light with a size and power that suit the room: at the 3D cursor shining down, or pointing
    at the surface that you click. On a ceiling, it hangs there and shines down.
    """
    from ..blend.lights.new_lights import add_light
    from ..blend.outliner import select_only

    light = add_light(context.scene, Vector(location), Vector(direction), size, power)
    select_only(context.view_layer, light)


def _can_aim(item: bpy.types.Object | None) -> bool:
    return item is not None and item.type == "LIGHT" and item.data.type in ("AREA", "SPOT")


@action(
    "Aim Light",
    needs=(needs(lambda context: _can_aim(context.object), "Select an area light or a spot light"),),
)
def aim_light(
    context: bpy.types.Context,
    target: Annotated[
        Point, Option("Point in world space that the light shines at", shown={"subtype": "TRANSLATION"})
    ] = ORIGIN,
) -> None:
    """Turn the active light towards a point."""
    from ..blend.lights.new_lights import turn_to

    turn_to(context.object, Vector(target))


class FIPT_GT_aim(bpy.types.Gizmo):
    """The end of a light's beam on the room; dragged, the light follows the surface under the pointer"""

    bl_idname = "FIPT_GT_aim"
    __slots__ = ("before",)

    def draw(self, context: bpy.types.Context) -> None:
        self.draw_preset_circle(self.matrix_world)

    def draw_select(self, context: bpy.types.Context, select_id: int) -> None:
        self.draw_preset_circle(self.matrix_world, select_id=select_id)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.before = context.object.matrix_world.copy()
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]) -> set[str]:
        if event.type == "MOUSEMOVE":
            from ..blend.lights.new_lights import turn_to

            surface = surface_under_pointer(context, event)
            if surface is not None:
                turn_to(context.object, surface.position)
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        if cancel:
            context.object.matrix_world = self.before
        else:
            bpy.ops.ed.undo_push(message="Aim Light")


class FIPT_GGT_aim(bpy.types.GizmoGroup):
    """The end of the active light's beam"""

    bl_label = "Aim Light"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"3D", "PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        item = context.object
        return context.mode == "OBJECT" and _can_aim(item) and NEW_LIGHT in item and item.select_get()

    def setup(self, context: bpy.types.Context) -> None:
        """Make the handle and the line to it."""
        self.handle = self.gizmos.new(FIPT_GT_aim.bl_idname)
        self.handle.color, self.handle.alpha = (1.0, 0.65, 0.0), 0.9
        self.handle.color_highlight, self.handle.alpha_highlight = (1.0, 1.0, 1.0), 1.0
        self.handle.scale_basis, self.handle.line_width = 0.25, 3.0
        self.handle.use_draw_modal = True

    def draw_prepare(self, context: bpy.types.Context) -> None:
        """Place the handle where the beam meets the room."""
        from ..blend.lights.new_lights import beam_end

        item = context.object
        # 2 m away where the beam meets nothing.
        end = beam_end(context.scene, context.evaluated_depsgraph_get(), item, 2.0)
        self.handle.matrix_basis = (
            Matrix.Translation(end) @ item.matrix_world.to_quaternion().to_matrix().to_4x4()
        )
