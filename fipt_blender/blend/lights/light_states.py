# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Named states of all lights and the environment: their switches, powers and colors, saved and recalled."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import bpy

from ...core.run.errors import FiptError
from ..marks import (
    COLOR,
    FIXTURE,
    MAPPING,
    ON,
    SOLO,
    STOPS,
    TINT,
    WORLD_FACTOR,
    WORLD_ON,
    lights_of,
    result_world,
)
from .light_state import SETTINGS, adopt, plain, refresh

# What a light's settings are where they are not set.
_DEFAULTS: dict[str, Any] = {ON: True, SOLO: False, STOPS: 0.0, TINT: 0}

# {"lights": {name: {"settings": {...}}}, "world": {"on", "factor", "rotation"} or null}
LightState = dict[str, Any]


def present(scene: bpy.types.Scene) -> LightState:
    """The state of the scene's lights as they are."""
    lights = {}
    for item in lights_of(scene):
        adopt(item)
        settings = _DEFAULTS | {key: plain(item[key]) for key in SETTINGS if key in item}
        lights[_key_of(item)] = {"settings": settings}
    return {"lights": lights, "world": _present_world(scene)}


def recall(scene: bpy.types.Scene, state: LightState) -> None:
    """Give the lights the settings of a state; lights that it does not know stay as they are."""
    for item in lights_of(scene):
        for key, value in state["lights"].get(_key_of(item), {"settings": {}})["settings"].items():
            item[key] = value
    if state["world"] is not None:
        _set_world(scene, state["world"])
    refresh(scene)


def write(state: LightState) -> str:
    """The state as text, for a property of the scene."""
    return json.dumps(state)


def read(text: str) -> LightState:
    """The state that `write` wrote.

    Raises:
        FiptError: ``state-damaged``.
    """
    try:
        state: LightState = json.loads(text)
        for entry in state["lights"].values():
            settings = {key: entry["settings"][key] for key in SETTINGS if key in entry["settings"]}
            if COLOR in settings:
                settings[COLOR] = _numbers(settings[COLOR])
            _numbers([settings.get(key, 0) for key in (STOPS, TINT, ON)])
            entry["settings"] = settings
        if state["world"] is not None:
            _numbers([state["world"][key] for key in ("on", "factor", "rotation")])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        text = "This light state is damaged."
        raise FiptError("state-damaged", text, "Remove it and save it again.") from error
    return state


def _numbers(values: Sequence[Any]) -> list[float]:
    """Three finite numbers.

    Raises:
        ValueError: they are not.
    """
    found = [float(value) for value in values]
    if len(found) != 3 or not all(map(math.isfinite, found)):
        raise ValueError("not three numbers")
    return found


def _key_of(item: bpy.types.Object) -> str:
    """By which a state knows a light: the run's name of a fixture, which renaming does not change."""
    return str(item.get(FIXTURE, item.name))


def _present_world(scene: bpy.types.Scene) -> dict[str, Any] | None:
    world = result_world(scene)
    if world is None:
        return None
    mapping = world.node_tree.nodes.get(MAPPING)
    rotation = 0.0 if mapping is None else float(mapping.inputs["Rotation"].default_value[2])
    return {
        "on": bool(world.get(WORLD_ON, True)),
        "factor": float(world.get(WORLD_FACTOR, 1.0)),
        "rotation": rotation,
    }


def _set_world(scene: bpy.types.Scene, values: Mapping[str, Any]) -> None:
    world = result_world(scene)
    if world is None:
        return
    world[WORLD_ON], world[WORLD_FACTOR] = values["on"], values["factor"]
    mapping = world.node_tree.nodes.get(MAPPING)
    if mapping is not None:
        mapping.inputs["Rotation"].default_value[2] = values["rotation"]
