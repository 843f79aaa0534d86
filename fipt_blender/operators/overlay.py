# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the operators that draw colours over the room."""

from __future__ import annotations

import bpy

from .reporting import reports_errors


class ShowsColors:
    """Mix-in of an operator that draws colours over the room or hides them; implement `color`."""

    bl_options = {"REGISTER"}

    show: bpy.props.BoolProperty(
        name="Show", description="Show or hide the colors", default=True, options={"SKIP_SAVE"}
    )

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        """Draw the colours over the scene's room.

        Raises:
            FiptError: the data for the colours is missing.
        """
        raise NotImplementedError

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture import overlay

        if self.show:
            self.color(context.scene)
        else:
            overlay.hide()
        return {"FINISHED"}
