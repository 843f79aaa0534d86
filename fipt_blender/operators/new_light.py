# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator of the section Lights that adds a light: at the 3D cursor, or pointing at a click."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from mathutils import Vector

from ..core.job.errors import FiptError

_PICK_TEXT = "Click what the new light shall point at; Escape gives up"
_NAVIGATION = ("MIDDLEMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION",
               "WHEELUPMOUSE", "WHEELDOWNMOUSE", "WHEELINMOUSE", "WHEELOUTMOUSE")  # fmt: skip


class FIPT_OT_add_light(bpy.types.Operator):
    """Add an area light whose size and power suit the room: at the 3D cursor shining down, or so that it
    points at what you click"""

    bl_idname = "fipt.add_light"
    bl_label = "Add Light"
    bl_options = {"REGISTER", "UNDO"}

    place: bpy.props.EnumProperty(
        name="Place",
        description="Where the light goes",
        items=[
            ("CURSOR", "At 3D Cursor", "At the 3D cursor, shining down", "CURSOR", 0),
            ("PICK", "Pointing at Click", "Pointing at the surface that you click", "RESTRICT_SELECT_OFF", 1),
        ],
        options={"SKIP_SAVE"},
    )
    location: bpy.props.FloatVectorProperty(
        name="Location",
        description="Centre of the light, in the world; the 3D cursor's if not given",
        subtype="TRANSLATION",
        options={"SKIP_SAVE"},
    )
    direction: bpy.props.FloatVectorProperty(
        name="Direction",
        description="Where the light shines, in the world",
        subtype="XYZ",
        default=(0.0, 0.0, -1.0),
        options={"SKIP_SAVE"},
    )
    size: bpy.props.FloatProperty(
        name="Size",
        description="Side of the square light; 0 for what suits the room",
        subtype="DISTANCE",
        min=0.0,
        options={"SKIP_SAVE"},
    )
    power: bpy.props.FloatProperty(
        name="Power",
        description="Power in watts; 0 for what makes the room as bright as its photographs",
        subtype="POWER",
        min=0.0,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Switch to object mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.new_lights import add_light, suggest
        from ..blend.outliner import select_only

        scene = context.scene
        hint = suggest(scene)
        if not self.properties.is_property_set("location"):
            self.location = scene.cursor.location
        self.size, self.power = self.size or hint.size, self.power or hint.watts
        try:
            item = add_light(scene, Vector(self.location), Vector(self.direction), self.size, self.power)
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        select_only(context.view_layer, item)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.place == "CURSOR" or self.properties.is_property_set("location"):
            return self.execute(context)
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Start this in a 3D view.")
            return {"CANCELLED"}
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set(iface_(_PICK_TEXT))
        context.area.header_text_set(iface_(_PICK_TEXT))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type in _NAVIGATION:
            return {"PASS_THROUGH"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"RUNNING_MODAL"}
        found = _view_under_mouse(context, event)
        if found is None:  # over the sidebar, or outside
            return {"RUNNING_MODAL"}
        from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

        from ..blend.new_lights import aim, suggest
        from ..blend.standing import find_surface

        region, space = found
        # Each quarter of a view split into four has a matrix of its own; the space's is the last one's.
        data = getattr(region, "data", None) or space.region_3d
        place = (event.mouse_x - region.x, event.mouse_y - region.y)
        depsgraph = context.evaluated_depsgraph_get()
        surface = find_surface(
            context.scene,
            depsgraph,
            region_2d_to_origin_3d(region, data, place),
            region_2d_to_vector_3d(region, data, place),
            skip_backs=space.shading.type == "SOLID" and space.shading.show_backface_culling,
        )
        if surface is None:
            self.report({"WARNING"}, "There is no surface under the mouse.")
            return {"RUNNING_MODAL"}
        distance = suggest(context.scene).distance
        self.location, self.direction = aim(context.scene, depsgraph, *surface, distance)
        self.cancel(context)
        return self.execute(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender too, when the window closes."""
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        if context.area is not None:
            context.area.header_text_set(None)


def _view_under_mouse(
    context: bpy.types.Context, event: bpy.types.Event
) -> tuple[bpy.types.Region, bpy.types.SpaceView3D] | None:
    """The 3D view under the mouse, if neither its sidebar nor its tools lie above it there."""
    for area in context.window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        inside = [
            region
            for region in area.regions
            if region.x <= event.mouse_x < region.x + region.width
            and region.y <= event.mouse_y < region.y + region.height
        ]
        if inside and all(region.type == "WINDOW" for region in inside):
            return inside[0], area.spaces.active
    return None
