# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Insert: objects that stand in the room."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.job.errors import FiptError
from ..properties.insert import ALIGNMENTS, BALLS, KINDS
from . import picture
from .polls import in_object_mode

if TYPE_CHECKING:
    from ..blend.standing import Guest, Stance, Surface

_WHEEL_TURN = math.radians(15.0)
_WHEEL_SCALE = 1.1
_NAVIGATION = ("MIDDLEMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION")
_FROM_PANEL = ("kind", "copy", "align", "turn", "scale", "drop")


class FIPT_OT_insert_object(bpy.types.Operator):
    """Place an object on the surface under the mouse. Click places it, the wheel turns it, Ctrl and the wheel
    scale it, ESC gives up"""

    bl_idname = "fipt.insert_object"
    bl_label = "Place"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Insert", description="What to place", items=KINDS, options={"SKIP_SAVE"}
    )
    object_name: bpy.props.StringProperty(
        name="Object", description="Name of the object; the panel's choice if empty", options={"SKIP_SAVE"}
    )
    collection_name: bpy.props.StringProperty(
        name="Collection",
        description="Name of the collection; the panel's choice if empty",
        options={"SKIP_SAVE"},
    )
    copy: bpy.props.BoolProperty(
        name="Place a Copy", description="Leave the object and place a copy", options={"SKIP_SAVE"}
    )
    align: bpy.props.EnumProperty(
        name="Align", description="How it stands on the surface", items=ALIGNMENTS, options={"SKIP_SAVE"}
    )
    turn: bpy.props.FloatProperty(
        name="Turn", description="Angle about its own up", subtype="ANGLE", options={"SKIP_SAVE"}
    )
    scale: bpy.props.FloatProperty(
        name="Scale", description="Factor on its own size", default=1.0, min=1e-4, options={"SKIP_SAVE"}
    )
    drop: bpy.props.BoolProperty(
        name="Drop to Surface",
        description="Its lowest point touches the surface; otherwise its origin lies on it",
        default=True,
        options={"SKIP_SAVE"},
    )
    location: bpy.props.FloatVectorProperty(
        name="Location",
        description="Point of the surface, in the world",
        subtype="TRANSLATION",
        options={"SKIP_SAVE"},
    )
    normal: bpy.props.FloatVectorProperty(
        name="Normal",
        description="Where the surface faces, in the world",
        default=(0.0, 0.0, 1.0),
        options={"SKIP_SAVE"},
    )
    view: bpy.props.StringProperty(
        name="View", description="Place it at a pixel of this view instead", options={"SKIP_SAVE"}
    )
    pixel: bpy.props.FloatVectorProperty(
        name="Pixel", description="Position in the view, from the top left", size=2, options={"SKIP_SAVE"}
    )

    across: bpy.props.FloatVectorProperty(
        name="Across", description="Direction of a row of balls, in the world", options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return in_object_mode(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.window is None or bpy.app.background:
            return self.execute(context)
        view = context.region_data
        if view is not None and not self.properties.is_property_set("across"):
            self.across = view.view_matrix.inverted().to_3x3().col[0]
        try:
            self._guest = self._invite(context)
        except FiptError as error:
            return self._refuse(error)
        self._surface: Surface | None = None
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(
            iface_("Click: place   Wheel: turn   Ctrl Wheel: scale   Esc, right click: give up")
        )
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self._guest.root not in bpy.data.objects:  # removed by a script in the meantime
            self._end(context)
            return {"CANCELLED"}
        if event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "MOUSEMOVE":
            self._follow(context, event)
            return {"PASS_THROUGH"}
        over = _view_under_mouse(context, event)
        if event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE") and over is not None:
            self._turn_wheel(context, event)
        elif event.type == "LEFTMOUSE" and event.value == "PRESS" and over is not None:
            self._follow(context, event)
            if self._surface is not None:
                self._end(context)
                self._select(context)
                return {"FINISHED"}
            self.report({"INFO"}, "There is no surface at that place")
        elif event.type in _NAVIGATION or event.type.startswith("NUMPAD") or over is None:
            return {"PASS_THROUGH"}
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender too, when the window closes or another file is loaded."""
        from ..blend.standing import give_up

        give_up(self._guest)
        self._end(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.standing import aside, give_up, stand

        try:
            self._guest = self._invite(context)
            try:
                with aside(self._guest):
                    surface = self._named_surface(context)
            except FiptError:
                give_up(self._guest)
                raise
        except FiptError as error:
            return self._refuse(error)
        stand(self._guest, surface, self._stance())
        self._remember(surface)
        self._select(context)
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        for name in ("align", "turn", "scale", "drop", "location"):
            layout.prop(self, name)

    def _invite(self, context: bpy.types.Context) -> Guest:
        """Make what is to be placed ready, as the properties or else the panel say."""
        from ..blend.insert import ball_size, make_balls
        from ..blend.standing import invite, invite_collection

        scene, settings = context.scene, context.scene.fipt.insert
        for name in _FROM_PANEL:
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(settings, name))
        room = scene.fipt.capture.room_objects(scene)
        if self.kind == "OBJECT":
            item = bpy.data.objects.get(self.object_name) if self.object_name else settings.object
            if item is None:
                raise _missing("object", self.object_name)
            self.object_name = item.name
            return invite(scene, item, self.copy, room)
        if self.kind == "COLLECTION":
            group = bpy.data.collections.get(self.collection_name) if self.collection_name else None
            group = group or (None if self.collection_name else settings.collection)
            if group is None:
                raise _missing("collection", self.collection_name)
            self.collection_name = group.name
            return invite_collection(scene, group)
        if not self.properties.is_property_set("across") and scene.camera is not None:
            self.across = scene.camera.matrix_world.to_3x3().col[0]
        return make_balls(scene, BALLS[self.kind], ball_size(room), self.across)

    def _named_surface(self, context: bpy.types.Context) -> Surface:
        """The place that the properties name; without one a free spot in the scene's camera."""
        from mathutils import Vector

        from ..blend import insert
        from ..blend.cameras import find_camera
        from ..blend.standing import Surface

        scene = context.scene
        if self.view:
            return insert.surface_at(scene, find_camera(self.view), *self.pixel)
        if self.properties.is_property_set("location"):
            normal = Vector(self.normal)
            if normal.length < 1e-6:
                raise FiptError("normal-zero", "The normal has no length.", "Name a direction.")
            return Surface(Vector(self.location), normal.normalized())
        if scene.camera is None:
            raise FiptError(
                "camera-missing", "The scene has no camera.", "Name a location, or a view and a pixel."
            )
        return insert.free_spot(scene, scene.camera)

    def _stance(self) -> Stance:
        from ..blend.standing import Stance

        return Stance(self.align == "UPRIGHT", self.turn, self.scale, self.drop)

    def _remember(self, surface: Surface) -> None:
        """Keep the place in the properties: adjusting the last operation then executes it there."""
        self.location, self.normal, self.view = surface.position, surface.normal, ""

    def _follow(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        found = _surface_under_mouse(context, event, self._guest)
        if found is not None:
            self._surface = found
            self._stand(context)

    def _turn_wheel(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        sign = 1.0 if event.type == "WHEELUPMOUSE" else -1.0
        if event.ctrl:
            self.scale *= _WHEEL_SCALE**sign
        else:
            self.turn += sign * _WHEEL_TURN * (0.1 if event.shift else 1.0)
        self._stand(context)

    def _stand(self, context: bpy.types.Context) -> None:
        from ..blend.standing import stand

        if self._surface is not None:
            stand(self._guest, self._surface, self._stance())
            self._remember(self._surface)

    def _select(self, context: bpy.types.Context) -> None:
        """Leave it selected, so that the artist can go on with it."""
        from ..blend.outliner import select_only

        item = bpy.data.objects[self._guest.root]
        if item.name in context.view_layer.objects:
            select_only(context.view_layer, item)

    def _end(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(None)
        if context.window is not None:
            context.window.cursor_modal_restore()

    def _refuse(self, error: FiptError) -> set[str]:
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}


def _missing(what: str, name: str) -> FiptError:
    if name:
        return FiptError(f"{what}-missing", f"There is no {what} '{name}'.", "Name one of the file.")
    return FiptError(f"{what}-missing", f"No {what} is chosen.", "Choose what to place first.")


def _view_under_mouse(
    context: bpy.types.Context, event: bpy.types.Event
) -> tuple[bpy.types.Region, bpy.types.SpaceView3D] | None:
    """The 3D view's main region below the mouse, unless a sidebar or header lies over it there."""
    x, y = event.mouse_x, event.mouse_y
    for area in context.window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        inside = [
            region
            for region in area.regions
            if region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
        ]
        if inside and all(region.type == "WINDOW" for region in inside):
            return inside[0], area.spaces.active
    return None


def _surface_under_mouse(context: bpy.types.Context, event: bpy.types.Event, guest: Guest) -> Surface | None:
    from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

    from ..blend.standing import aside, find_surface

    found = _view_under_mouse(context, event)
    if found is None:
        return None
    region, space = found
    # Each quarter of a view split into four has a matrix of its own; the space's is the last one's.
    data = getattr(region, "data", None) or space.region_3d
    place = (event.mouse_x - region.x, event.mouse_y - region.y)
    with aside(guest):
        return find_surface(
            context.scene,
            context.evaluated_depsgraph_get(),
            region_2d_to_origin_3d(region, data, place),
            region_2d_to_vector_3d(region, data, place),
            skip_backs=space.shading.type == "SOLID" and space.shading.show_backface_culling,
        )


class FIPT_OT_remove_inserted(bpy.types.Operator):
    """Remove the balls, copies and instances that were placed; your own objects go back to where they were"""

    bl_idname = "fipt.remove_inserted"
    bl_label = "Remove Inserted"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return in_object_mode(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.standing import remove_inserted

        count = remove_inserted(context.scene)
        if not count:
            self.report({"INFO"}, "Nothing has been placed")
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (FIPT_OT_insert_object, FIPT_OT_remove_inserted, *picture.CLASSES)
