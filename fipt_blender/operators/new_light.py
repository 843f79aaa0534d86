# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights that add lights: at the 3D cursor, aimed with the mouse, or the lamps that
the mesh lacks.
"""

from __future__ import annotations

import bpy
from mathutils import Vector

from .pointer import PicksInViewport, surface_under_pointer
from .polls import all_of, in_object_mode
from .reporting import reports_errors

_PICK_TEXT = "Click: Point the new light at this surface   Esc, Right Click: Cancel"


class FIPT_OT_add_light(PicksInViewport, bpy.types.Operator):
    bl_idname = "fipt.add_light"
    bl_label = "Add Light"
    bl_description = (
        "Add an area light with a size and power that suit the room: at the 3D cursor shining down, or"
        " pointing at the surface that you click. On a ceiling, it hangs there and shines down"
    )
    bl_options = {"REGISTER", "UNDO"}
    text_in_header = True

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
        description="Center of the light, in world space. If not set, the 3D cursor is used",
        subtype="TRANSLATION",
        options={"SKIP_SAVE"},
    )
    direction: bpy.props.FloatVectorProperty(
        name="Direction",
        description="Direction in which the light shines, in world space",
        subtype="XYZ",
        default=(0.0, 0.0, -1.0),
        options={"SKIP_SAVE"},
    )
    size: bpy.props.FloatProperty(
        name="Size",
        description="Side of the square light. If 0, it is chosen to suit the room",
        subtype="DISTANCE",
        min=0.0,
        options={"SKIP_SAVE"},
    )
    power: bpy.props.FloatProperty(
        name="Power",
        description="Power in watts. If 0, the room becomes about as bright as in its photographs",
        subtype="POWER",
        min=0.0,
        options={"SKIP_SAVE"},
    )

    poll = all_of(in_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.new_lights import add_light, suggest
        from ..blend.outliner import select_only

        scene = context.scene
        suggestion = suggest(scene)
        if not self.properties.is_property_set("location"):
            self.location = scene.cursor.location
        self.size, self.power = self.size or suggestion.size, self.power or suggestion.watts
        light = add_light(scene, Vector(self.location), Vector(self.direction), self.size, self.power)
        select_only(context.view_layer, light)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.place == "CURSOR" or self.properties.is_property_set("location"):
            return self.execute(context)
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Run this operator in a 3D Viewport.")
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
