# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframes of a light's power, color and switch: drivers lead them from the object's custom properties to
the strengths of its nodes and Blender lights.

The drivers are simple expressions, which Blender evaluates without Python: they also work in renders in the
background, in files with scripts disabled, and where the add-on is not installed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy

from ..color_spaces import scene_matrix
from ..marks import (
    ANIMATED,
    BACKSIDE,
    BASE,
    COLOR,
    FRONT,
    GATE,
    ON,
    STOPS,
    TINT,
    fixture_lights,
    remove_marks,
)
from .color import LUMINANCE, luminance
from .fixture_nodes import emitting_sides, surfaces
from .tint import shown_color, unit_of

KEYED = (ON, STOPS, COLOR)
_OFF = (0.0, 0.0, 0.0)
_VARIABLES = {
    "lit": f'["{ON}"]',
    "gate": f'["{GATE}"]',
    "stops": f'["{STOPS}"]',
    **{name: f'["{COLOR}"][{channel}]' for channel, name in enumerate("rgb")},
}
# What is driven: its owner and path, its index (-1 for a number), and the expression.
_Driven = tuple[bpy.types.bpy_struct, str, int, str]


def is_animated(item: bpy.types.Object) -> bool:
    """Whether a light is driven by its custom properties, which may have keyframes."""
    return ANIMATED in item


def keyframe(item: bpy.types.Object, frame: float) -> None:
    """Add keyframes of a light's switch, power and color, as they are now.

    Args:
        item: a fixture or a light that was added.
        frame: the keyframes' frame.
    """
    item[ANIMATED] = 1
    item[ON], item[STOPS] = bool(item.get(ON, True)), float(item.get(STOPS, 0.0))
    take_color(item)
    item[GATE] = int(item.get(GATE, 0))
    drive(item)
    for key in KEYED:
        item.keyframe_insert(f'["{key}"]', frame=frame)


def take_color(item: bpy.types.Object) -> None:
    """Store the shown color of an animated light as its custom color, which alone has keyframes."""
    item[COLOR] = shown_color(item)
    item[TINT] = 1


def clear(item: bpy.types.Object) -> None:
    """Remove a light's keyframes and drivers; it stays as it is on the present frame."""
    for owner, path, index, _ in _driven(item):
        owner.driver_remove(path, index)
    if item.animation_data is not None and item.animation_data.action is not None:
        for frame_path in (f'["{key}"]' for key in KEYED):
            _remove_keyframes(item, frame_path)
    remove_marks(item, ANIMATED, GATE)


def action_of(item: bpy.types.Object) -> tuple[str, str]:
    """Names of an animated light's action and of its slot there ("" before Blender 4.4); "" for none."""
    data = item.animation_data
    if not is_animated(item) or data is None or data.action is None:
        return "", ""
    slot = getattr(data, "action_slot", None)
    return data.action.name, "" if slot is None else slot.identifier


def take_action(item: bpy.types.Object, action: str, slot: str) -> None:
    """Animate a light by what `action_of` has told of an earlier one; nothing happens for ""."""
    found = bpy.data.actions.get(action)
    if found is None:
        return
    data = item.animation_data_create()
    data.action = found
    if slot and slot in found.slots:
        data.action_slot = found.slots[slot]
    item[ANIMATED] = 1
    take_color(item)


def drive(item: bpy.types.Object) -> None:
    """Give an animated light, and the Blender lights that stand for it, the drivers that are missing."""
    for owner, path, index, expression in _driven(item):
        curve = _find_driver(owner, path, index)
        if curve is None:
            curve = owner.driver_add(path, index)
            curve.driver.type = "SCRIPTED"
            for name, source in _VARIABLES.items():
                variable = curve.driver.variables.new()
                variable.name, variable.type = name, "SINGLE_PROP"
                variable.targets[0].id, variable.targets[0].data_path = item, source
        if curve.driver.expression != expression:
            curve.driver.expression = expression
    for surface in surfaces(item):
        if hasattr(surface.material, "cycles") and not fixture_lights(item):
            # A lamp that is off on this frame may shine on the next one.
            surface.material.cycles.emission_sampling = emitting_sides(surface.front, surface.back)
    item.update_tag()  # the drivers follow


def _driven(item: bpy.types.Object) -> Iterator[_Driven]:
    """Everything of a light that its custom properties drive."""
    channels = [_weighted(row) for row in scene_matrix().tolist()]
    for surface in surfaces(item):
        for name, base in ((FRONT, surface.front), (BACKSIDE, surface.back)):
            node = surface.material.node_tree.nodes.get(name)
            if node is None:
                continue
            yield node.inputs["Strength"], "default_value", -1, _strength_expression(item, base)
            for channel, mixed in enumerate(channels):
                yield node.inputs["Color"], "default_value", channel, mixed
    lights = fixture_lights(item) if item.type == "MESH" else [item]
    for light in lights:
        yield light.data, "energy", -1, _strength_expression(item, light.get(BASE, _OFF))
        for channel, mixed in enumerate(channels):
            yield light.data, "color", channel, mixed


def _strength_expression(item: bpy.types.Object, base: Sequence[float]) -> str:
    """The strength of the color whose luminance times it is that of `base` at the light's power, or 0."""
    shines = "(lit if gate == 0 else gate > 0)"
    value = unit_of(item) * luminance(base)
    return f"{shines} * {value:.9g} * pow(2, stops) / max({_weighted(LUMINANCE)}, 1e-6)"


def _weighted(weights: Sequence[float]) -> str:
    """The sum of the channels of the keyed color with these weights."""
    weighted = zip(weights, "rgb", strict=True)
    return " + ".join(f"{weight:.9g} * {letter}" for weight, letter in weighted if weight)


def _find_driver(owner: bpy.types.bpy_struct, path: str, index: int) -> bpy.types.FCurve | None:
    data = owner.id_data.animation_data
    if data is None:
        return None
    full = owner.path_from_id(path) if owner != owner.id_data else path
    return data.drivers.find(full, index=max(index, 0))


def _remove_keyframes(item: bpy.types.Object, path: str) -> None:
    """Remove an object's F-curves of a path, from the action's channels of this object only."""
    curves = _channels(item.animation_data)
    for curve in [curve for curve in curves if curve.data_path == path]:
        curves.remove(curve)


def _channels(data: bpy.types.AnimData) -> bpy.types.bpy_prop_collection:
    """The F-curves of an object's slot; actions had no slots before Blender 4.4."""
    slot = getattr(data, "action_slot", None)
    if slot is None:
        return data.action.fcurves
    for layer in data.action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(slot)
            if bag is not None:
                return bag.fcurves
    return data.action.fcurves if hasattr(data.action, "fcurves") else []
