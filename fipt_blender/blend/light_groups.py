# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups of Cycles: a render pass for each fixture, the environment and the lights that were added."""

from __future__ import annotations

import json

import bpy

from ..properties.lights import FIXTURE, FIXTURE_LIGHT, NEW_LIGHT
from . import light_state

ENVIRONMENT = "Environment"
NEW_LIGHTS = "New Lights"
_OURS = "fipt_light_groups"  # of a view layer: names of the groups that we added


def make_light_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """One group for each fixture, one for the environment and one for the lights that were added.

    Groups that the artist made stay; ours are made anew.

    Returns:
        Names of the groups; the passes are called "Combined_" and the name.
    """
    remove_light_groups(scene, layer)
    names = []
    world = light_state.own_world(scene)
    if world is not None:
        world.lightgroup = _add(layer, ENVIRONMENT)
        names.append(world.lightgroup)
    for item in light_state.lights_of(scene):
        # Dots separate layers, passes and channels in the names of an EXR file.
        name = _add(layer, item[FIXTURE].replace(".", "_") if FIXTURE in item else NEW_LIGHTS)
        for each in (item, *light_state.fixture_lights(item)):
            each.lightgroup = name
        if name not in names:
            names.append(name)
    layer[_OURS] = json.dumps(names)
    return names


def remove_light_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    """Take back what `make_light_groups` made; does nothing otherwise."""
    if _OURS not in layer:
        return
    names = set(json.loads(layer[_OURS]))
    for item in scene.objects:
        if (FIXTURE in item or NEW_LIGHT in item or FIXTURE_LIGHT in item) and item.lightgroup in names:
            item.lightgroup = ""
    world = light_state.own_world(scene)
    if world is not None and world.lightgroup in names:
        world.lightgroup = ""
    for name in names:
        _remove(scene, layer, name)
    del layer[_OURS]


def has_light_groups(layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer has groups of ours."""
    return _OURS in layer


def _add(layer: bpy.types.ViewLayer, name: str) -> str:
    group = layer.lightgroups.get(name) or layer.lightgroups.add(name=name)
    return str(group.name)


def _remove(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, name: str) -> None:
    groups = layer.lightgroups
    index = groups.find(name)
    if index < 0:
        return
    if hasattr(groups, "remove"):
        groups.remove(groups[index])
        return
    layer.active_lightgroup_index = index  # Blender 4.2 has the operator alone
    with bpy.context.temp_override(scene=scene, view_layer=layer):
        bpy.ops.scene.view_layer_remove_lightgroup()
