# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: states of all lights, and IES profiles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import NEW_LIGHT, fixture_lights
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from .action import action, file_dialog
from .lights import LightName, find_light, own_lights
from .polls import needs

State = Annotated[str, "Name of the state. If empty, the active state of the list is used"]
_has_states = needs(lambda context: len(context.scene.fipt.lights.states), "Save a light state first")


@action("Save Light State", needs=own_lights)
def save_light_state(
    scene: bpy.types.Scene,
    name: Annotated[str, "Name of the state; a state of that name is replaced. If empty, it is chosen"] = "",
) -> None:
    """Save the power, color and switch of all lights and of the environment under a name."""
    from ..blend.lights import light_states
    from ..core.run.parts import free_name

    settings = scene.fipt.lights
    entry = settings.states.get(name) if name else None
    if entry is None:
        entry = settings.states.add()
        entry.name = name or free_name(iface_("Lights"), [each.name for each in settings.states])
    entry.data = light_states.write(light_states.present(scene))
    settings.active_state = settings.states.find(entry.name)


@action("Recall Light State", needs=(_has_states,))
def recall_light_state(scene: bpy.types.Scene, state: State = "") -> None:
    """Give all lights and the environment the power, color and switch of a saved state."""
    from ..blend.lights import light_states

    light_states.recall(scene, light_states.read(scene.fipt.lights.states[_index(scene, state)].data))


@action("Remove Light State", needs=(_has_states,))
def remove_light_state(scene: bpy.types.Scene, state: State = "") -> None:
    """Remove a saved state. The lights stay as they are."""
    settings, index = scene.fipt.lights, _index(scene, state)
    settings.states.remove(index)
    settings.active_state = max(min(index, len(settings.states) - 1), 0)


@action("IES Profile...", needs=own_lights, invoke=file_dialog)
def set_ies_profile(
    scene: bpy.types.Scene,
    filepath: Annotated[str, Option("The file of the profile", "File", shown={"subtype": "FILE_PATH"})] = "",
    filter_glob: Annotated[str, Option("Files to show", shown={"options": {"HIDDEN"}})] = "*.ies",
    light: LightName = "",
) -> None:
    """Put the file of a lamp's IES profile into an IES Texture node of the light, which becomes a point and
    shines along its -Z axis. The profile multiplies its power. Only Cycles renders it.
    """
    from ..blend.lights.ies import set_profile

    for each in _blender_lights(scene, light):
        set_profile(each, Path(bpy.path.abspath(filepath)))


def _index(scene: bpy.types.Scene, state: str) -> int:
    """A state's place in the list.

    Raises:
        FiptError: ``state-missing``.
    """
    settings = scene.fipt.lights
    index = settings.states.find(state) if state else settings.active_state
    if not 0 <= index < len(settings.states):
        text = f"There is no light state '{state}'." if state else "No light state is selected."
        raise FiptError("state-missing", text, "Select a state in the list Light States.")
    return int(index)


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
