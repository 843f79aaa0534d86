# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives light its unit."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .lights import find_light, has_lights, light_name_property
from .polls import all_of, in_object_mode, is_own_room
from .reporting import reports_errors

BY = (
    ("LUMENS", "Lumens of a Lamp", "What the package of the active lamp says; the lamp as it is set now"),
    ("LUX", "Lux at the 3D Cursor", "What a lux meter has shown on a horizontal surface at the 3D cursor"),
)


class FIPT_OT_calibrate_light(bpy.types.Operator):
    bl_idname = "fipt.calibrate_light"
    bl_label = "Calibrate Light..."
    bl_description = (
        "Type the lumens of one lamp or the lux at one place: all lights and the environment are in watts"
        " and lumens from then on, as a physical sky and lamps of other files are. Pictures stay as they are"
    )
    bl_options = {"REGISTER", "UNDO"}

    by: bpy.props.EnumProperty(name="By", description="What is known", items=BY)
    lumens: bpy.props.FloatProperty(
        name="Lumens", description="Luminous flux of the lamp", min=0.01, soft_max=20000.0, default=800.0
    )
    lux: bpy.props.FloatProperty(
        name="Lux", description="Illuminance at the 3D cursor", min=0.01, soft_max=100000.0, default=300.0
    )
    light: light_name_property("lamp")

    poll = all_of(has_lights, is_own_room, in_object_mode)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "by", expand=True)
        layout.prop(self, "lumens" if self.by == "LUMENS" else "lux")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.calibration import calibrate_by_lamp, calibrate_by_lux

        scene = context.scene
        if self.by == "LUMENS":
            factor = calibrate_by_lamp(scene, find_light(scene, self.light), self.lumens)
        else:
            factor = calibrate_by_lux(scene, tuple(scene.cursor.location), self.lux)
        self.report({"INFO"}, iface_("All light was multiplied by {:.4g}").format(factor))
        return {"FINISHED"}
