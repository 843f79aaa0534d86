"""What lies under the mouse pointer, and the mix-ins of operators that wait for clicks."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy
from bpy.app.translations import pgettext_iface as iface_
from mathutils import Vector

from .action import Action

# Events that move the view or zoom; modal operators pass them on. The mouse wheel zooms as well.
NAVIGATION = ("MIDDLEMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION")
Point = tuple[float, float, float]
ORIGIN, DOWN = (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)  # the default point and direction
WHEEL = ("WHEELUPMOUSE", "WHEELDOWNMOUSE", "WHEELINMOUSE", "WHEELOUTMOUSE")


def view_under_pointer(
    context: bpy.types.Context, event: bpy.types.Event
) -> tuple[bpy.types.Region, bpy.types.SpaceView3D] | None:
    """The 3D viewport under the pointer; None where a sidebar, toolbar or header covers it."""
    x, y = event.mouse_x, event.mouse_y
    for area in context.window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        regions = [
            region
            for region in area.regions
            if region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
        ]
        if regions and all(region.type == "WINDOW" for region in regions):
            return regions[0], area.spaces.active
    return None


class PointerRay(NamedTuple):
    """The ray through the pointer: origin and unit direction in the world, whether backs are not drawn."""

    origin: Vector
    direction: Vector
    skip_backs: bool


def ray_under_pointer(context: bpy.types.Context, event: bpy.types.Event) -> PointerRay | None:
    """The ray from the eye through the pointer; None where it is not over a 3D viewport."""
    from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

    view = view_under_pointer(context, event)
    if view is None:
        return None
    region, space = view
    # In quad view each region has its own matrix; the space's is that of the last one.
    data = getattr(region, "data", None) or space.region_3d
    position = (event.mouse_x - region.x, event.mouse_y - region.y)
    return PointerRay(
        region_2d_to_origin_3d(region, data, position),
        region_2d_to_vector_3d(region, data, position),
        space.shading.type == "SOLID" and space.shading.show_backface_culling,
    )


class Surface(NamedTuple):
    """A point on a surface: position and unit normal towards the viewer, in the world."""

    position: Vector
    normal: Vector


def surface_under_pointer(context: bpy.types.Context, event: bpy.types.Event) -> Surface | None:
    """The visible surface under the pointer, in world coordinates; None where there is none."""
    from ..blend.ray_hits import hits

    ray = ray_under_pointer(context, event)
    if ray is None:
        return None
    hit = next(hits(context.scene, context.evaluated_depsgraph_get(), *ray), None)
    return None if hit is None else Surface(hit.position, -hit.normal if hit.behind else hit.normal)


def is_click(event: bpy.types.Event) -> bool:
    """Whether the left mouse button was pressed."""
    return bool(event.type == "LEFTMOUSE" and event.value == "PRESS")


def is_cancel(event: bpy.types.Event) -> bool:
    """Whether Esc or the right mouse button was pressed."""
    return event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS"


class WaitsForClicks(Action):
    """Mix-in of a modal operator that waits for clicks; a subclass implements `modal`.

    Attributes:
        cursor: shape of the mouse pointer meanwhile.
        text_in_header: whether the text is in the header of the editor too, not only in the status bar.
    """

    cursor = "CROSSHAIR"
    text_in_header = False

    def wait_for_clicks(self, context: bpy.types.Context, text: str) -> set[str]:
        """Begin to wait; the text says for what."""
        context.window.cursor_modal_set(self.cursor)
        self.say(context, text)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def is_in_viewport(self, context: bpy.types.Context) -> bool:
        """Whether the operator runs in a 3D viewport; reported if not."""
        found = context.area is not None and context.area.type == "VIEW_3D"
        if not found:
            self.report({"ERROR"}, "Run this operator in a 3D Viewport.")
        return found

    def say(self, context: bpy.types.Context, text: str) -> None:
        """Show what to click next."""
        context.workspace.status_text_set(iface_(text))
        if self.text_in_header:
            context.area.header_text_set(iface_(text))

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop waiting. Blender calls this too, when the window closes or another file is loaded."""
        context.workspace.status_text_set(None)
        if context.window is not None:
            context.window.cursor_modal_restore()
        if self.text_in_header and context.area is not None:
            context.area.header_text_set(None)


class PicksInViewport(WaitsForClicks):
    """Mix-in of an operator that waits for one click in a 3D viewport and then executes."""

    cursor = "EYEDROPPER"

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if is_cancel(event):
            self.cancel(context)
            return {"CANCELLED"}
        if not is_click(event):
            passes = event.type in (*NAVIGATION, *WHEEL, "MOUSEMOVE")
            return {"PASS_THROUGH"} if passes else {"RUNNING_MODAL"}
        if view_under_pointer(context, event) is None:  # a click on another part of the window
            return {"PASS_THROUGH"}
        if not self.take_click(context, event):
            return {"RUNNING_MODAL"}
        result: set[str] = self.execute(context)
        if result == {"CANCELLED"}:  # the report says why; another click may do
            return {"RUNNING_MODAL"}
        self.cancel(context)
        return result

    def take_click(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        """Set the operator's properties from what was clicked; False to wait for another click."""
        raise NotImplementedError


class PicksAlongRay(PicksInViewport):
    """The same for an action on `ray`, the one through the pointer; scripts give it by its parts.

    Attributes:
        pick_text: what the click does.
    """

    pick_text = ""
    origin: bpy.props.FloatVectorProperty(
        name="Origin", description="Start of the ray", subtype="XYZ", unit="LENGTH", options={"SKIP_SAVE"}
    )
    direction: bpy.props.FloatVectorProperty(
        name="Direction", description="Direction of the ray", default=DOWN, options={"SKIP_SAVE"}
    )
    skip_backs: bpy.props.BoolProperty(
        name="Skip Backs",
        description="Look through surfaces that are seen from behind",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.wait_for_clicks(context, self.pick_text)

    def take_click(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        ray = ray_under_pointer(context, event)
        assert ray is not None  # `modal` has asked whether a viewport is there
        self.origin, self.direction, self.skip_backs = ray
        return True

    def arguments(self) -> dict[str, Any]:
        ray = PointerRay(Vector(self.origin), Vector(self.direction), self.skip_backs)
        return {**super().arguments(), "ray": ray}
