# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Parts: which surfaces share a material."""

from __future__ import annotations

import bpy

from .overlay import ShowsColors


class FIPT_OT_show_parts(ShowsColors, bpy.types.Operator):
    """Colour the room by its parts, one colour a part"""

    bl_idname = "fipt.show_parts"
    bl_label = "Show Parts"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.fipt.parts.counts:
            cls.poll_message_set("Check the views first: that finds the parts too")
            return False
        return True

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        from ..blend.survey import show_parts

        show_parts(scene)


CLASSES = (FIPT_OT_show_parts,)
