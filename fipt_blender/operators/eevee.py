# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights that make the room look right in EEVEE."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import BAKED, light_probe
from ..core.run.errors import FiptError
from .polls import all_of, has_results, in_object_mode, needs
from .reporting import reports_errors


class FIPT_OT_prepare_eevee(bpy.types.Operator):
    bl_idname = "fipt.prepare_eevee"
    bl_label = "Set Up for EEVEE"
    bl_description = (
        "Make EEVEE the scene's render engine, convert all fixtures to Blender lights, and add a light probe"
        " volume of the room's size and bake it"
    )
    bl_options = {"REGISTER", "UNDO"}

    bake: bpy.props.BoolProperty(
        name="Bake", description="Bake the light probe volume, which needs a window", default=True
    )

    poll = all_of(has_results, in_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.eevee import prepare

        inexact = prepare(context.scene)
        if inexact:
            text = iface_("Lights of another shape than their fixtures: {}")
            self.report({"INFO"}, text.format(", ".join(inexact)))
        if self.bake and not bpy.app.background:
            bake(context)
        return {"FINISHED"}


class FIPT_OT_bake_probe(bpy.types.Operator):
    """Bake the light probe volume again, after a change of the lights"""

    bl_idname = "fipt.bake_probe"
    bl_label = "Bake Light Probe"
    bl_options = {"REGISTER"}

    poll = all_of(
        needs(lambda context: light_probe(context.scene) is not None, "Use Set Up for EEVEE first"),
        in_object_mode,
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        if bpy.app.background:
            raise FiptError(
                "window-missing",
                "EEVEE bakes light probes only in a window.",
                "Open the file in Blender's window.",
            )
        bake(context)
        return {"FINISHED"}


def bake(context: bpy.types.Context) -> None:
    """Bake our light probe volume, with Blender's own progress bar."""
    volume = light_probe(context.scene)
    if volume is None:
        return
    context.view_layer.update()  # a new volume
    with context.temp_override(active_object=volume, object=volume):
        bpy.ops.object.lightprobe_cache_bake("INVOKE_DEFAULT", subset="ALL")
    volume[BAKED] = 1
