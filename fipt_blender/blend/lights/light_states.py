# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Named states of all lights and the environment: saved, recalled, and blended as light adds up."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import bpy

from ...core.run.errors import FiptError
from ..marks import (
    COLOR,
    FIXTURE,
    MAPPING,
    MISSING_LAMP,
    ON,
    SOLO,
    STOPS,
    TINT,
    WORLD_FACTOR,
    WORLD_ON,
    lights_of,
    result_world,
)
from .color import luminance
from .light_state import SETTINGS, adopt, apply_settings, plain, refresh, shines
from .tint import base_of, powered, split

# What a light's settings are where they are not set.
_DEFAULTS: dict[str, Any] = {ON: True, SOLO: False, STOPS: 0.0, TINT: 0}
_BLACK = (0.0, 0.0, 0.0)

# {"lights": {name: {"settings": {...}, "rgb": what shines}}, "world": {"on", "factor", "rotation"} or null}
LightState = dict[str, Any]


def present(scene: bpy.types.Scene) -> LightState:
    """The state of the scene's lights as they are."""
    items = lights_of(scene)
    solo = any(item.get(SOLO, False) for item in items)
    lights = {}
    for item in items:
        adopt(item)
        settings = _DEFAULTS | {key: plain(item[key]) for key in SETTINGS if key in item}
        rgb = powered(item, base_of(item)) if shines(item, solo) else _BLACK
        lights[key_of(item)] = {"settings": settings, "rgb": list(rgb)}
    return {"lights": lights, "world": _present_world(scene)}


def as_photographed(scene: bpy.types.Scene) -> LightState:
    """The state with all that the photographs show as estimated; lights that the artist added are off."""
    return estimated(scene, lambda item: FIXTURE in item or MISSING_LAMP in item, world_on=True)


def only(scene: bpy.types.Scene, lamp: bpy.types.Object) -> LightState:
    """The state in which one light shines, at its present power, and nothing else."""
    state = estimated(scene, lambda item: False, world_on=False)
    state["lights"][key_of(lamp)] = _switched_on(lamp)
    return state


def evening(scene: bpy.types.Scene) -> LightState:
    """The state without the environment, every light on at its present power."""
    state = present(scene)
    state["lights"] = {key_of(item): _switched_on(item) for item in lights_of(scene)}
    if state["world"] is not None:
        state["world"]["on"] = False
    return state


def recall(scene: bpy.types.Scene, state: LightState) -> None:
    """Give the lights the settings of a state; lights that it does not know stay as they are."""
    for item in lights_of(scene):
        entry = state["lights"].get(key_of(item))
        if entry is not None:
            apply_settings(item, entry["settings"])
    if state["world"] is not None:
        _set_world(scene, state["world"])
    refresh(scene)


def blend(scene: bpy.types.Scene, first: LightState, second: LightState, factor: float) -> None:
    """Give the lights what lies between two states, in radiance, so that pictures blend likewise.

    Args:
        scene: the lights' scene.
        first, second: results of `present` and the like.
        factor: 0 for the first to 1 for the second; these two are recalled exactly.
    """
    if factor <= 0.0 or factor >= 1.0:
        recall(scene, first if factor <= 0.0 else second)
        return
    for item in lights_of(scene):
        pair = [state["lights"].get(key_of(item)) for state in (first, second)]
        if None not in pair:
            rgb = mixed(pair[0]["rgb"], pair[1]["rgb"], factor)
            apply_settings(item, settings_of(rgb, base_of(item)))
    worlds = [state["world"] for state in (first, second)]
    if None not in worlds:
        shone = [world["factor"] if world["on"] else 0.0 for world in worlds]
        turns = [world["rotation"] for world in worlds]
        strength, rotation = (low + factor * (high - low) for low, high in (shone, turns))
        _set_world(scene, {"on": strength > 0.0, "factor": strength, "rotation": rotation})
    refresh(scene)


def mixed(first: Sequence[float], second: Sequence[float], factor: float) -> list[float]:
    """What lies between two rgb."""
    return [(1.0 - factor) * a + factor * b for a, b in zip(first, second, strict=True)]


def settings_of(rgb: Sequence[float], base: Sequence[float]) -> dict[str, Any]:
    """The settings that make a light of this base rgb shine with `rgb`."""
    if luminance(rgb) <= 0.0 or luminance(base) <= 0.0:
        return {ON: False, SOLO: False}
    color, _ = split(rgb)
    stops = math.log2(luminance(rgb) / luminance(base))
    return {ON: True, SOLO: False, STOPS: stops, TINT: 1, COLOR: list(color)}


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
            entry["settings"] = {key: entry["settings"][key] for key in SETTINGS if key in entry["settings"]}
            entry["rgb"] = _numbers(entry["rgb"])
            if COLOR in entry["settings"]:
                entry["settings"][COLOR] = _numbers(entry["settings"][COLOR])
            _numbers([entry["settings"].get(key, 0) for key in (STOPS, TINT, ON)])
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


def estimated(scene: bpy.types.Scene, on: Callable[[bpy.types.Object], bool], world_on: bool) -> LightState:
    """A state with every light as estimated, on or off."""
    lights = {}
    for item in lights_of(scene):
        settings = _DEFAULTS | {ON: bool(on(item))}
        lights[key_of(item)] = {"settings": settings, "rgb": list(base_of(item) if on(item) else _BLACK)}
    world = _present_world(scene)
    if world is not None:
        world = {"on": world_on, "factor": 1.0, "rotation": 0.0}
    return {"lights": lights, "world": world}


def _switched_on(item: bpy.types.Object) -> dict[str, Any]:
    """A light's entry as it is, but on."""
    settings = {key: plain(item[key]) for key in SETTINGS if key in item}
    rgb = list(powered(item, base_of(item)))
    return {"settings": _DEFAULTS | settings | {ON: True, SOLO: False}, "rgb": rgb}


def key_of(item: bpy.types.Object) -> str:
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
