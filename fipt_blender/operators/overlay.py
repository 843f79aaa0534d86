# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators share that draw colours over the room."""

from __future__ import annotations

import bpy

from ..core.job.errors import FiptError


class ShowsColors:
    """Mix-in of an operator that colours the room, or takes the colours away; implement `color`."""

    bl_options = {"REGISTER"}

    show: bpy.props.BoolProperty(name="Show", default=True, options={"SKIP_SAVE"})

    @staticmethod
    def color(scene: bpy.types.Scene) -> None:
        """Draw the colours over the scene's room.

        Raises:
            FiptError: what the colours need is not there.
        """
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend import overlay

        if not self.show:
            overlay.hide()
            return {"FINISHED"}
        try:
            self.color(context.scene)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        return {"FINISHED"}
