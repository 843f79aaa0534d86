# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights that make the room look right in EEVEE."""

from __future__ import annotations

from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import BAKED, light_probe
from ..core.run.errors import FiptError
from .action import REGISTER, action
from .polls import has_results, in_object_mode, needs


@action("Set Up for EEVEE", needs=(has_results, in_object_mode))
def prepare_eevee(
    context: bpy.types.Context,
    bake: Annotated[bool, "Bake the light probe volume, which needs a window"] = True,
) -> str | None:
    """Make EEVEE the scene's render engine, convert all fixtures to Blender lights, and add a light probe
    volume of the room's size and bake it.
    """
    from ..blend.lights.eevee import prepare

    inexact = prepare(context.scene)
    if bake and not bpy.app.background:
        _bake(context)
    text = iface_("Lights of another shape than their fixtures: {}")
    return text.format(", ".join(inexact)) if inexact else None


@action(
    "Bake Light Probe",
    needs=(
        needs(lambda context: light_probe(context.scene) is not None, "Use Set Up for EEVEE first"),
        in_object_mode,
    ),
    options=REGISTER,
)
def bake_probe(context: bpy.types.Context) -> None:
    """Bake the light probe volume again, after a change of the lights."""
    if bpy.app.background:
        text, remedy = "EEVEE bakes light probes only in a window.", "Open the file in Blender's window."
        raise FiptError("window-missing", text, remedy)
    _bake(context)


def _bake(context: bpy.types.Context) -> None:
    """Bake our light probe volume, with Blender's own progress bar."""
    volume = light_probe(context.scene)
    if volume is None:
        return
    context.view_layer.update()  # a new volume
    with context.temp_override(active_object=volume, object=volume):
        bpy.ops.object.lightprobe_cache_bake("INVOKE_DEFAULT", subset="ALL")
    volume[BAKED] = 1
