# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds balls that show the room's light. All other objects are placed by Blender's own means."""

from __future__ import annotations

import bpy

from .polls import all_of, in_object_mode


class FIPT_OT_add_ball(bpy.types.Operator):
    """Add a ball that stands on the 3D cursor, as on a film set"""

    bl_idname = "fipt.add_ball"
    bl_label = "Add Ball"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="Kind",
        items=(
            ("GRAY_BALL", "Gray", "Matte, 18% gray: shows where the light comes from", "SPHERE", 0),
            ("MIRROR_BALL", "Mirror", "Chrome: reflects its surroundings", "SHADING_RENDERED", 1),
        ),
    )
    size: bpy.props.FloatProperty(
        name="Diameter",
        description="Diameter of the ball. If 0, one that suits the room",
        subtype="DISTANCE",
        min=0.0,
        options={"SKIP_SAVE"},
    )

    poll = all_of(in_object_mode)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.insert.balls import add_ball, ball_size
        from ..blend.outliner import select_only

        scene = context.scene
        self.size = self.size or ball_size(scene.fipt.capture.room_objects(scene))
        ball = add_ball(scene, scene.cursor.location, self.kind.lower(), self.size)
        select_only(context.view_layer, ball)
        return {"FINISHED"}
