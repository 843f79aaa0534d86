# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Insert: place objects in the room, remove them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..properties.insert import ALIGNMENTS, BALLS, KINDS
from .pointer import (
    NAVIGATION,
    WaitsForClicks,
    is_cancel,
    is_click,
    surface_under_pointer,
    view_under_pointer,
)
from .polls import all_of, in_object_mode
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..blend.insert.placing import Placement, Stance
    from ..blend.insert.surfaces import Surface

_WHEEL_TURN = math.radians(15.0)
_PLACE_TEXT = "Click: Place   Wheel: Rotate   Ctrl Wheel: Scale   Esc, Right Click: Cancel"
_FROM_PANEL = ("kind", "copy", "align", "turn", "scale", "drop")


class FIPT_OT_insert_object(WaitsForClicks, bpy.types.Operator):
    bl_idname = "fipt.insert_object"
    bl_label = "Place"
    bl_description = (
        "Place an object on the surface under the mouse pointer. Click to place it, use the wheel to"
        " rotate it and Ctrl Wheel to scale it, press Esc to cancel"
    )
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Insert", description="What to place", items=KINDS, options={"SKIP_SAVE"}
    )
    object_name: bpy.props.StringProperty(
        name="Object",
        description="Name of the object. If empty, the one in the panel is used",
        options={"SKIP_SAVE"},
    )
    collection_name: bpy.props.StringProperty(
        name="Collection",
        description="Name of the collection. If empty, the one in the panel is used",
        options={"SKIP_SAVE"},
    )
    copy: bpy.props.BoolProperty(
        name="Place a Copy",
        description="Leave the object where it is and place a copy",
        options={"SKIP_SAVE"},
    )
    align: bpy.props.EnumProperty(
        name="Align",
        description="Orientation of the object on the surface",
        items=ALIGNMENTS,
        options={"SKIP_SAVE"},
    )
    turn: bpy.props.FloatProperty(
        name="Rotation",
        description="Rotation about the object's up axis",
        subtype="ANGLE",
        options={"SKIP_SAVE"},
    )
    scale: bpy.props.FloatProperty(
        name="Scale", description="Scale factor of the object", default=1.0, min=1e-4, options={"SKIP_SAVE"}
    )
    drop: bpy.props.BoolProperty(
        name="Drop to Surface",
        description="Place the object's lowest point on the surface instead of its origin",
        default=True,
        options={"SKIP_SAVE"},
    )
    location: bpy.props.FloatVectorProperty(
        name="Location",
        description="Point on the surface, in world space",
        subtype="TRANSLATION",
        options={"SKIP_SAVE"},
    )
    normal: bpy.props.FloatVectorProperty(
        name="Normal",
        description="Normal of the surface, in world space",
        default=(0.0, 0.0, 1.0),
        options={"SKIP_SAVE"},
    )
    view: bpy.props.StringProperty(
        name="View",
        description="Name of a view. If set, the object is placed at a pixel of it",
        options={"SKIP_SAVE"},
    )
    pixel: bpy.props.FloatVectorProperty(
        name="Pixel",
        description="Position in the view, in pixels from the top left",
        size=2,
        options={"SKIP_SAVE"},
    )

    across: bpy.props.FloatVectorProperty(
        name="Across", description="Direction of a row of balls, in world space", options={"SKIP_SAVE"}
    )

    poll = all_of(in_object_mode)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.window is None or bpy.app.background:
            return self.execute(context)
        region_3d = context.region_data
        if region_3d is not None and not self.properties.is_property_set("across"):
            self.across = region_3d.view_matrix.inverted().to_3x3().col[0]
        try:
            self._placement = self._begin_placing(context)
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._surface: Surface | None = None
        return self.wait_for_clicks(context, _PLACE_TEXT)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self._placement.root not in bpy.data.objects:  # a script has removed it
            super().cancel(context)
            return {"CANCELLED"}
        if is_cancel(event):
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "MOUSEMOVE":
            self._follow(context, event)
            return {"PASS_THROUGH"}
        over_view = view_under_pointer(context, event) is not None
        if event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE") and over_view:
            self._turn_wheel(context, event)
        elif is_click(event) and over_view:
            self._follow(context, event)
            if self._surface is not None:
                super().cancel(context)
                self._select(context)
                return {"FINISHED"}
            self.report({"INFO"}, "There is no surface under the mouse pointer")
        elif event.type in NAVIGATION or event.type.startswith("NUMPAD") or not over_view:
            return {"PASS_THROUGH"}
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Undo the placing and stop waiting."""
        from ..blend.insert.placing import cancel_placing

        cancel_placing(self._placement)
        super().cancel(context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.insert.placing import cancel_placing, moved_aside, place

        self._placement = self._begin_placing(context)
        try:
            with moved_aside(self._placement):
                surface = self._named_surface(context)
        except FiptError:
            cancel_placing(self._placement)
            raise
        place(self._placement, surface, self._stance())
        self._remember(surface)
        self._select(context)
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        for name in ("align", "turn", "scale", "drop", "location"):
            layout.prop(self, name)

    def _begin_placing(self, context: bpy.types.Context) -> Placement:
        """Prepare the object to place, as the properties say; the panel decides where they are not set."""
        from ..blend.insert.placing import begin_placing, begin_placing_collection
        from ..blend.insert.sample_objects import ball_size, make_balls

        scene, settings = context.scene, context.scene.fipt.insert
        for name in _FROM_PANEL:
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(settings, name))
        room = scene.fipt.capture.room_objects(scene)
        if self.kind == "OBJECT":
            chosen = bpy.data.objects.get(self.object_name) if self.object_name else settings.object
            if chosen is None:
                raise _missing("object", self.object_name)
            self.object_name = chosen.name
            return begin_placing(scene, chosen, self.copy, room)
        if self.kind == "COLLECTION":
            name = self.collection_name
            collection = bpy.data.collections.get(name) if name else settings.collection
            if collection is None:
                raise _missing("collection", name)
            self.collection_name = collection.name
            return begin_placing_collection(scene, collection)
        if not self.properties.is_property_set("across") and scene.camera is not None:
            self.across = scene.camera.matrix_world.to_3x3().col[0]
        return make_balls(scene, BALLS[self.kind], ball_size(room), self.across)

    def _named_surface(self, context: bpy.types.Context) -> Surface:
        """The place that the properties name; if none, a free spot in view of the scene's camera."""
        from mathutils import Vector

        from ..blend.capture.cameras import find_camera
        from ..blend.insert.surfaces import Surface, free_spot, surface_at

        scene = context.scene
        if self.view:
            return surface_at(scene, find_camera(self.view, scene), *self.pixel)
        if self.properties.is_property_set("location"):
            normal = Vector(self.normal)
            if normal.length < 1e-6:
                raise FiptError("normal-zero", "The normal has no length.", "Give a direction.")
            return Surface(Vector(self.location), normal.normalized())
        if scene.camera is None:
            raise FiptError(
                "camera-missing", "The scene has no active camera.", "Give a location, or a view and a pixel."
            )
        return free_spot(scene, scene.camera)

    def _stance(self) -> Stance:
        from ..blend.insert.placing import Stance

        return Stance(self.align == "UPRIGHT", self.turn, self.scale, self.drop)

    def _remember(self, surface: Surface) -> None:
        """Store the place in the properties, so that Adjust Last Operation uses it."""
        self.location, self.normal, self.view = surface.position, surface.normal, ""

    def _follow(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        from ..blend.insert.placing import moved_aside

        with moved_aside(self._placement):
            surface = surface_under_pointer(context, event)
        if surface is not None:
            self._surface = surface
            self._place(context)

    def _turn_wheel(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        sign = 1.0 if event.type == "WHEELUPMOUSE" else -1.0
        if event.ctrl:
            self.scale *= 1.1**sign
        else:
            self.turn += sign * _WHEEL_TURN * (0.1 if event.shift else 1.0)
        self._place(context)

    def _place(self, context: bpy.types.Context) -> None:
        from ..blend.insert.placing import place

        if self._surface is not None:
            place(self._placement, self._surface, self._stance())
            self._remember(self._surface)

    def _select(self, context: bpy.types.Context) -> None:
        """Select the placed object, for further edits."""
        from ..blend.outliner import select_only

        placed = bpy.data.objects[self._placement.root]
        if placed.name in context.view_layer.objects:
            select_only(context.view_layer, placed)


def _missing(what: str, name: str) -> FiptError:
    if name:
        return FiptError(f"{what}-missing", f"There is no {what} '{name}'.", f"Choose another {what}.")
    return FiptError(f"{what}-missing", f"No {what} is selected.", f"Select the {what} to place first.")


class FIPT_OT_remove_inserted(bpy.types.Operator):
    bl_idname = "fipt.remove_inserted"
    bl_label = "Remove Inserted"
    bl_description = (
        "Remove the balls, copies and instances that were placed. Your own objects return to their"
        " former places"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(in_object_mode)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.insert.placing import remove_inserted

        count = remove_inserted(context.scene)
        if not count:
            self.report({"INFO"}, "Nothing has been placed")
            return {"CANCELLED"}
        return {"FINISHED"}
