"""Applies the settings of a scene's lights (custom properties of their objects) to their strengths.

No strength is saved to be restored: it is computed from the settings each time it is written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import bpy

from ..marks import (
    BACKGROUND,
    BASE,
    COLOR,
    KELVIN,
    KEPT_SKY,
    ON,
    SOLO,
    STOPS,
    TINT,
    WORLD,
    WORLD_FACTOR,
    WORLD_ON,
    WRITTEN,
    fixture_lights,
    lights_of,
    remove_marks,
    result_world,
)
from ..own_materials import own_materials
from .fixture_nodes import node_strength, surfaces, write_radiance, write_shown
from .light_groups import add_to_groups
from .tint import base_of, blender_color, shone, shown_color, shown_temperature, tinted, unit_of

SETTINGS = (ON, SOLO, STOPS, TINT, COLOR, KELVIN)
DEFAULTS: dict[str, Any] = {ON: True, SOLO: False, STOPS: 0.0, TINT: 0}  # where they are not set
Setting = bool | int | float | Sequence[float]


def list_lights(scene: bpy.types.Scene) -> None:
    """Update the panel's list, where the add-on is enabled, and the light groups that we made."""
    add_to_groups(scene)
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


def change(scene: bpy.types.Scene, item: bpy.types.Object, values: Mapping[str, Setting]) -> None:
    """Change settings of one light and update its strength."""
    own_materials(scene)
    adopt(item)
    if TINT in values:  # a new choice starts from the light's present colour
        item[COLOR], item[KELVIN] = (
            item.get(COLOR, shown_color(item)),
            item.get(KELVIN, shown_temperature(item)),
        )
    for key, value in values.items():
        item[key] = value
    if SOLO in values:
        refresh(scene)
    else:
        _write(item, _any_solo(scene), _shown(scene))


def plain(value: Setting) -> Setting:
    """A custom property's value, arrays as lists."""
    return value if isinstance(value, bool | int | float | str) else list(value)


def switch_all(on: bool, scene: bpy.types.Scene | None = None) -> None:
    """Switch all lights of the list and the environment of a scene (the context's by default) on or off.

    A fixture that is off is black. No light is soloed any more.
    """
    scene = scene or bpy.context.scene
    world = result_world(scene)
    if world is not None:
        world[WORLD_ON] = on
    for item in lights_of(scene):
        adopt(item)
        item[SOLO], item[ON] = False, on
    refresh(scene)


def reset(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Reset a light to its estimated power and colour, switched on."""
    remove_marks(item, *SETTINGS)
    item[WRITTEN] = _strength(item)
    refresh(scene)


def refresh(scene: bpy.types.Scene) -> None:
    """Update the strengths of all lights and of the environment of a scene from their settings."""
    own_materials(scene)
    items = lights_of(scene)
    solo, shown = any(item.get(SOLO, False) for item in items), _shown(scene)
    for item in items:
        adopt(item)
        _write(item, solo, shown)
    refresh_world(scene)


def shines(item: bpy.types.Object, any_solo: bool) -> bool:
    """Whether a light is on, given whether any light of its scene is soloed."""
    return bool(item.get(SOLO, False) if any_solo else item.get(ON, True))


def adopt(item: bpy.types.Object) -> None:
    """Turn a strength that the artist entered in a node or a light's properties into settings."""
    written, strength = item.get(WRITTEN), _strength(item)
    if written is None or strength is None or math.isclose(strength, written, rel_tol=1e-4, abs_tol=1e-9):
        return
    base_strength = unit_of(item) * blender_color(tinted(item, _written_base(item)))[1]
    item[ON] = strength > 0.0
    if strength > 0.0 and base_strength > 0.0:
        item[STOPS] = math.log2(strength / base_strength)
    item[WRITTEN] = strength


def has_set_power(scene: bpy.types.Scene, item: bpy.types.Object, light: bpy.types.Object) -> bool:
    """Whether a Blender light of a fixture has the power and colour that the fixture's settings give it."""
    color, watts = _color_and_watts(light, item, shines(item, _any_solo(scene)))
    # Blender, too, changes colours: to another working space.
    return all(
        math.isclose(value * light.data.energy, target * watts, rel_tol=1e-4, abs_tol=1e-6)
        for value, target in zip(light.data.color, color, strict=True)
    )


def refresh_world(scene: bpy.types.Scene) -> None:
    """Update the environment's strength from its settings. While a light is solo, no world shines."""
    world, solo = result_world(scene), _any_solo(scene)
    for layer in scene.view_layers:
        if solo and scene.world != world and layer.use_sky:
            layer.use_sky, layer[KEPT_SKY] = False, 1
        elif KEPT_SKY in layer and not (solo and scene.world != world):
            layer.use_sky = True
            remove_marks(layer, KEPT_SKY)
    if world is None:
        return
    background = world.node_tree.nodes.get(BACKGROUND)
    if background is None:  # removed by the artist
        return
    on = bool(world[WORLD]) and world.get(WORLD_ON, True) and not solo
    visible = _shown(scene) in ("ESTIMATED", "ORIGINAL", "EMISSION")
    strength = unit_of(world) * world.get(WORLD_FACTOR, 1.0)
    background.inputs["Strength"].default_value = strength if on and visible else 0.0


def _any_solo(scene: bpy.types.Scene) -> bool:
    return any(item.get(SOLO, False) for item in lights_of(scene))


def _shown(scene: bpy.types.Scene) -> str:
    return scene.fipt.materials.shown if hasattr(scene, "fipt") else "ESTIMATED"


def _strength(item: bpy.types.Object) -> float | None:
    """Watts of a light; strength of the shining side of a fixture's first surface; None where unknown."""
    if item.type == "LIGHT":
        return float(item.data.energy)
    first = next(iter(surfaces(item)), None)
    return None if first is None else node_strength(first.material, back=max(first.front) <= 0.0)


def _written_base(item: bpy.types.Object) -> Sequence[float]:
    """The base rgb of what `_strength` reads."""
    first = next(iter(surfaces(item)), None)
    if first is None:
        return base_of(item)
    return first.back if max(first.front) <= 0.0 else first.front


def _write(item: bpy.types.Object, any_solo: bool, shown: str) -> None:
    on, off = shines(item, any_solo), (0.0, 0.0, 0.0)
    emitting = surfaces(item)
    if item.type == "LIGHT":
        _write_light(item, item, on)
    elif emitting:
        for surface in emitting:
            front = shone(item, surface.front) if on else off
            back = shone(item, surface.back) if on else off
            write_radiance(surface.material, front, back, sampled=not fixture_lights(item))
            write_shown(surface.material, shown)
        for light in fixture_lights(item):
            _write_light(light, item, on)
    strength = _strength(item)
    if strength is not None:
        item[WRITTEN] = strength


def _write_light(item: bpy.types.Object, settings: bpy.types.Object, on: bool) -> None:
    item.data.color, item.data.energy = _color_and_watts(item, settings, on)


def _color_and_watts(
    item: bpy.types.Object, settings: bpy.types.Object, on: bool
) -> tuple[tuple[float, float, float], float]:
    """Colour and power of a Blender light, of which `settings` carries the settings."""
    color, energy = blender_color(shone(settings, item[BASE]))
    return color, energy if on else 0.0
