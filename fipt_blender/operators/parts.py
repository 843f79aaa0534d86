# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Parts: which surfaces share a material."""

from __future__ import annotations

import bpy

from .overlay import ShowsColors
from .polls import all_of, needs


class FIPT_OT_show_parts(ShowsColors, bpy.types.Operator):
    """Display the parts of the room, each in its own color"""

    bl_idname = "fipt.show_parts"
    bl_label = "Show Parts"

    poll = all_of(
        needs(
            lambda context: context.scene.fipt.parts.counts,
            "Use Check Views first, in the section Capture; it finds the parts as well",
        )
    )

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        from ..blend.capture.survey import show_parts

        show_parts(scene)
