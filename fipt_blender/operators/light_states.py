# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: states of all lights, and IES profiles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy_extras.io_utils import ImportHelper

from ..blend.marks import NEW_LIGHT, fixture_lights
from ..core.run.errors import FiptError
from .lights import NeedsLights, find_light, light_name_property
from .polls import all_of, needs
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..blend.lights.light_states import LightState


class FIPT_OT_save_light_state(NeedsLights, bpy.types.Operator):
    """Save the power, color and switch of all lights and of the environment under a name"""

    bl_idname = "fipt.save_light_state"
    bl_label = "Save Light State"
    bl_options = {"REGISTER", "UNDO"}

    name: bpy.props.StringProperty(
        name="Name",
        description="Name of the state; a state of that name is replaced. If empty, it is chosen",
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights import light_states
        from ..core.run.parts import free_name

        settings = context.scene.fipt.lights
        entry = settings.states.get(self.name) if self.name else None
        if entry is None:
            entry = settings.states.add()
            entry.name = self.name or free_name(iface_("Lights"), [each.name for each in settings.states])
        entry.data = light_states.write(light_states.present(context.scene))
        settings.active_state = settings.states.find(entry.name)
        return {"FINISHED"}


class _NeedsState:
    """Mix-in of operators on a saved state."""

    state: bpy.props.StringProperty(
        name="State",
        description="Name of the state. If empty, the active state of the list is used",
        options={"SKIP_SAVE"},
    )

    poll = all_of(needs(lambda context: len(context.scene.fipt.lights.states), "Save a light state first"))

    def index(self, scene: bpy.types.Scene) -> int:
        """The state's place in the list.

        Raises:
            FiptError: ``state-missing``.
        """
        settings = scene.fipt.lights
        index = settings.states.find(self.state) if self.state else settings.active_state
        if not 0 <= index < len(settings.states):
            text = f"There is no light state '{self.state}'." if self.state else "No light state is selected."
            raise FiptError("state-missing", text, "Select a state in the list Light States.")
        return int(index)

    def read(self, scene: bpy.types.Scene) -> LightState:
        """The state.

        Raises:
            FiptError: ``state-missing`` or ``state-damaged``.
        """
        from ..blend.lights import light_states

        return light_states.read(scene.fipt.lights.states[self.index(scene)].data)


class FIPT_OT_recall_light_state(_NeedsState, bpy.types.Operator):
    """Give all lights and the environment the power, color and switch of a saved state"""

    bl_idname = "fipt.recall_light_state"
    bl_label = "Recall Light State"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights import light_states

        light_states.recall(context.scene, self.read(context.scene))
        return {"FINISHED"}


class FIPT_OT_remove_light_state(_NeedsState, bpy.types.Operator):
    """Remove a saved state. The lights stay as they are"""

    bl_idname = "fipt.remove_light_state"
    bl_label = "Remove Light State"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.fipt.lights
        index = self.index(context.scene)
        settings.states.remove(index)
        settings.active_state = max(min(index, len(settings.states) - 1), 0)
        return {"FINISHED"}


def _blender_lights(scene: bpy.types.Scene, name: str) -> list[bpy.types.Object]:
    """The Blender lights of a row of the list.

    Raises:
        FiptError: ``fixture-missing``; ``fixture-emits`` for a fixture whose surface still emits.
    """
    item = find_light(scene, name)
    lights = [item] if NEW_LIGHT in item and item.type == "LIGHT" else fixture_lights(item)
    if not lights:
        text = f"The surface of '{item.name}' emits by itself."
        raise FiptError("fixture-emits", text, "Use Convert to Blender Light first.")
    return lights


class FIPT_OT_set_ies_profile(NeedsLights, ImportHelper, bpy.types.Operator):
    bl_idname = "fipt.set_ies_profile"
    bl_label = "IES Profile..."
    bl_description = (
        "Put the file of a lamp's IES profile into an IES Texture node of the light, which becomes a point"
        " and shines along its -Z axis. The profile multiplies its power. Only Cycles renders it"
    )
    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".ies"

    filter_glob: bpy.props.StringProperty(default="*.ies", options={"HIDDEN"})
    light: light_name_property("light")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.ies import set_profile

        for light in _blender_lights(context.scene, self.light):
            set_profile(light, Path(bpy.path.abspath(self.filepath)))
        return {"FINISHED"}
