# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From what a light's settings say (custom properties of its object) to how it shines, for all of a scene.

Nothing is ever saved and restored: strengths follow from the settings each time they are written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import bpy

from ..properties.lights import (
    BACK,
    BASE,
    COLOR,
    FIXTURE,
    FIXTURE_LIGHT,
    KELVIN,
    NEW_LIGHT,
    ON,
    OWN_WORLD,
    SOLO,
    STOPS,
    TINT,
    WORLD,
    WORLD_FACTOR,
    WORLD_ON,
    WRITTEN,
)
from .fixture_nodes import node_strength, write_radiance, write_shown
from .tint import powered, shown_color, shown_temperature, split, tinted

SETTINGS = (ON, SOLO, STOPS, TINT, COLOR, KELVIN)
BACKGROUND = "FIPT Background"


def lights_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's fixtures by name, then the lights that were added."""
    items = [item for item in scene.objects if FIXTURE in item or NEW_LIGHT in item]
    return sorted(items, key=lambda item: (FIXTURE not in item, item.name))


def list_lights(scene: bpy.types.Scene) -> None:
    """Bring the panel's list up to date; does nothing where the add-on is not enabled (batch jobs)."""
    if not hasattr(scene, "fipt"):
        return
    settings = scene.fipt.lights
    chosen = settings.active_light()
    chosen = None if chosen is None else chosen.object
    settings.lights.clear()
    for index, item in enumerate(lights_of(scene)):
        row = settings.lights.add()
        row.name, row.object = item.name, item
        if item == chosen:
            settings.active = index
    settings.active = min(max(settings.active, 0), max(len(settings.lights) - 1, 0))


def change(scene: bpy.types.Scene, item: bpy.types.Object, values: Mapping[str, Any]) -> None:
    """Change settings of one light, and let it shine accordingly."""
    adopt(item)
    if TINT in values:  # a choice starts from the colour that the light has
        item[COLOR], item[KELVIN] = (
            item.get(COLOR, shown_color(item)),
            item.get(KELVIN, shown_temperature(item)),
        )
    for key, value in values.items():
        item[key] = value
    if SOLO in values:
        refresh(scene)
    else:
        _write(item, shines(item, _any_solo(scene)), _shown(scene))


def change_all(scene: bpy.types.Scene, items: Iterable[bpy.types.Object], values: Mapping[str, Any]) -> None:
    """Change settings of several lights."""
    for item in items:
        adopt(item)
        for key, value in values.items():
            item[key] = value
    refresh(scene)


def reset(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Bring a light back to its estimated power and colour; it is then on."""
    for key in SETTINGS:
        if key in item:
            del item[key]
    item[WRITTEN] = _strength(item)
    refresh(scene)


def refresh(scene: bpy.types.Scene) -> None:
    """Let all lights and the environment of a scene shine as their settings say."""
    items = lights_of(scene)
    solo, shown = any(item.get(SOLO, False) for item in items), _shown(scene)
    for item in items:
        adopt(item)
        _write(item, shines(item, solo), shown)
    refresh_world(scene)


def shines(item: bpy.types.Object, any_solo: bool) -> bool:
    """Whether a light is on, given whether any light of its scene is soloed."""
    return bool(item.get(SOLO, False) if any_solo else item.get(ON, True))


def adopt(item: bpy.types.Object) -> None:
    """Take over a strength that the artist typed into a node or a light's own settings."""
    written, now = item.get(WRITTEN), _strength(item)
    if written is None or now is None or math.isclose(now, written, rel_tol=1e-4, abs_tol=1e-9):
        return
    plain = split(tinted(item, _main_base(item)))[1]
    item[ON] = now > 0.0
    if now > 0.0 and plain > 0.0:
        item[STOPS] = math.log2(now / plain)
    item[WRITTEN] = now


def fixture_lights(item: bpy.types.Object) -> list[bpy.types.Object]:
    """The Blender lights that stand for a fixture."""
    return [child for child in item.children if FIXTURE_LIGHT in child]


def states_of(scene: bpy.types.Scene) -> dict[str, dict[str, Any]]:
    """Settings of all fixtures of a scene by name, to be kept when results are applied anew."""
    states = {}
    for item in lights_of(scene):
        if FIXTURE in item:
            adopt(item)
            state = {key: _plain(item[key]) for key in (*SETTINGS, BASE, BACK) if key in item}
            states[item[FIXTURE]] = {"settings": state, "converted": bool(fixture_lights(item))}
    return states


def keep_states(
    scene: bpy.types.Scene, items: Iterable[bpy.types.Object], states: Mapping[str, Mapping[str, Any]]
) -> None:
    """Give new fixtures the settings that those of the same name and radiance had, and write all lights."""
    for item in items:
        state = states.get(item[FIXTURE])
        if state is None or any(state["settings"].get(key) != _plain(item[key]) for key in (BASE, BACK)):
            continue
        for key in SETTINGS:
            if key in state["settings"]:
                item[key] = state["settings"][key]
        if state["converted"]:
            from .convert import fixture_to_lights

            fixture_to_lights(scene, item)
    refresh(scene)
    list_lights(scene)


def own_world(scene: bpy.types.Scene) -> bpy.types.World | None:
    """Our world of a scene, shown or not."""
    for world in (scene.world, scene.get(OWN_WORLD)):
        if world is not None and WORLD in world:
            return world
    return None


def refresh_world(scene: bpy.types.Scene) -> None:
    """Let the environment shine as its settings say; does nothing without a world of ours."""
    world = own_world(scene)
    if world is None:
        return
    background = world.node_tree.nodes.get(BACKGROUND)
    if background is None:  # the artist has built his own
        return
    on = bool(world[WORLD]) and world.get(WORLD_ON, True) and not _any_solo(scene)
    visible = _shown(scene) in ("ESTIMATED", "ORIGINAL", "EMISSION")
    background.inputs["Strength"].default_value = world.get(WORLD_FACTOR, 1.0) if on and visible else 0.0


def _any_solo(scene: bpy.types.Scene) -> bool:
    return any(item.get(SOLO, False) for item in lights_of(scene))


def _shown(scene: bpy.types.Scene) -> str:
    return scene.fipt.materials.shown if hasattr(scene, "fipt") else "ESTIMATED"


def _main_base(item: bpy.types.Object) -> Any:
    """The base whose strength `_strength` tells."""
    base = item.get(BASE, (1.0, 1.0, 1.0))
    return item.get(BACK, base) if max(base) <= 0.0 else base


def _strength(item: bpy.types.Object) -> float | None:
    if item.type == "LIGHT":
        return float(item.data.energy)
    if item.type != "MESH" or not item.data.materials or item.data.materials[0] is None:
        return None
    return node_strength(item.data.materials[0], back=max(item.get(BASE, (1.0,))) <= 0.0)


def _write(item: bpy.types.Object, on: bool, shown: str) -> None:
    off = (0.0, 0.0, 0.0)
    if item.type == "LIGHT":
        _write_light(item, item, on)
    elif item.type == "MESH" and item.data.materials and item.data.materials[0] is not None:
        material = item.data.materials[0]
        front = powered(item, item[BASE]) if on else off
        back = powered(item, item.get(BACK, off)) if on else off
        write_radiance(material, front, back, sampled=not fixture_lights(item))
        write_shown(material, shown)
        for light in fixture_lights(item):
            _write_light(light, item, on)
    strength = _strength(item)
    if strength is not None:
        item[WRITTEN] = strength


def _write_light(item: bpy.types.Object, settings: bpy.types.Object, on: bool) -> None:
    item.data.color, energy = split(powered(settings, item[BASE]))
    item.data.energy = energy if on else 0.0


def _plain(value: Any) -> Any:
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
