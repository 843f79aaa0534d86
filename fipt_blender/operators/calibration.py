# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives light its unit."""

from __future__ import annotations

from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.declared import Option
from .action import action, dialog
from .lights import LightName, find_light, has_lights
from .polls import in_object_mode, is_own_room

BY = (
    ("LUMENS", "Lumens of a Lamp", "What the package of the active lamp says; the lamp as it is set now"),
    ("LUX", "Lux at the 3D Cursor", "What a lux meter has shown on a horizontal surface at the 3D cursor"),
)


def _draw(self: Any, context: bpy.types.Context) -> None:
    self.layout.use_property_split = True
    self.layout.prop(self, "by", expand=True)
    self.layout.prop(self, "lumens" if self.by == "LUMENS" else "lux")


@action("Calibrate Light...", needs=(has_lights, is_own_room, in_object_mode), invoke=dialog, draw=_draw)
def calibrate_light(
    scene: bpy.types.Scene,
    by: Annotated[str, Option("What is known", choices=BY)] = "LUMENS",
    lumens: Annotated[
        float, Option("Luminous flux of the lamp", low=0.01, shown={"soft_max": 20000.0})
    ] = 800.0,
    lux: Annotated[
        float, Option("Illuminance at the 3D cursor", low=0.01, shown={"soft_max": 100000.0})
    ] = 300.0,
    light: LightName = "",
) -> str:
    """Type the lumens of one lamp or the lux at one place: all lights and the environment are in watts
    and lumens from then on, as a physical sky and lamps of other files are. Pictures stay as they are.
    """
    from ..blend.lights.calibration import calibrate_by_lamp, calibrate_by_lux

    if by == "LUMENS":
        factor = calibrate_by_lamp(scene, find_light(scene, light), lumens)
    else:
        factor = calibrate_by_lux(scene, tuple(scene.cursor.location), lux)
    return iface_("All light was multiplied by {:.4g}").format(factor)
