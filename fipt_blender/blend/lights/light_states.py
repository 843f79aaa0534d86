# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Named states of all lights and the environment: their switches, powers and colors, saved and recalled."""

from __future__ import annotations

import json
from typing import Any

import bpy

from ...core.run.errors import FiptError
from ..marks import FIXTURE, MAPPING, ON, SOLO, STOPS, TINT, WORLD_FACTOR, WORLD_ON, lights_of, result_world
from .light_state import SETTINGS, adopt, plain, refresh

# What a light's settings are where they are not set.
_DEFAULTS: dict[str, Any] = {ON: True, SOLO: False, STOPS: 0.0, TINT: 0}


def present(scene: bpy.types.Scene) -> str:
    """The state of the scene's lights as they are, for a property of the scene.

    JSON: {"lights": {name: {"settings": {...}}}, "world": {"on", "factor", "rotation"} or null}.
    """
    lights = {}
    for item in lights_of(scene):
        adopt(item)
        settings = _DEFAULTS | {key: plain(item[key]) for key in SETTINGS if key in item}
        lights[_key_of(item)] = {"settings": settings}
    world, values = result_world(scene), None
    if world is not None:
        mapping = world.node_tree.nodes.get(MAPPING)
        rotation = 0.0 if mapping is None else float(mapping.inputs["Rotation"].default_value[2])
        on, factor = bool(world.get(WORLD_ON, True)), float(world.get(WORLD_FACTOR, 1.0))
        values = {"on": on, "factor": factor, "rotation": rotation}
    return json.dumps({"lights": lights, "world": values})


def recall(scene: bpy.types.Scene, text: str) -> None:
    """Give the lights the settings of a state; lights that it does not know stay as they are.

    Raises:
        FiptError: ``state-damaged``; nothing has changed then.
    """
    try:
        state = json.loads(text)
        settings = {name: dict(entry["settings"]) for name, entry in state["lights"].items()}
        values = state["world"] and [float(state["world"][key]) for key in ("on", "factor", "rotation")]
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FiptError("state-damaged") from error
    for item in lights_of(scene):
        for key, value in settings.get(_key_of(item), {}).items():
            if key in SETTINGS:
                item[key] = value
    world = result_world(scene)
    if values is not None and world is not None:
        world[WORLD_ON], world[WORLD_FACTOR] = bool(values[0]), values[1]
        mapping = world.node_tree.nodes.get(MAPPING)
        if mapping is not None:
            mapping.inputs["Rotation"].default_value[2] = values[2]
    refresh(scene)


def _key_of(item: bpy.types.Object) -> str:
    """By which a state knows a light: the run's name of a fixture, which renaming does not change."""
    return str(item.get(FIXTURE, item.name))
