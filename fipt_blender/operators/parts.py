# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Parts: which surfaces share a material."""

from __future__ import annotations

import bpy

from ..core.job.errors import FiptError


class FIPT_OT_show_parts(bpy.types.Operator):
    """Colour the room by its parts, one colour a part"""

    bl_idname = "fipt.show_parts"
    bl_label = "Show Parts"
    bl_options = {"REGISTER"}

    show: bpy.props.BoolProperty(name="Show", default=True, options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.parts.counts:
            cls.poll_message_set("Check the views first: that finds the parts too")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend import overlay, survey

        if not self.show:
            overlay.hide()
            return {"FINISHED"}
        try:
            survey.show_parts(context.scene)
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (FIPT_OT_show_parts,)
