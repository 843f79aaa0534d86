"""Cycles' light groups: a render pass for each fixture, the environment and the lights that were added."""

from __future__ import annotations

import json

import bpy

from ..marks import (
    LIGHT_GROUPS,
    fixture_lights,
    has_light_groups,
    is_fixture,
    is_our_light,
    lights_of,
    remove_marks,
    result_world,
)

ENVIRONMENT = "Environment"
NEW_LIGHTS = "New Lights"


def make_light_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """One group for each fixture, one for the environment and one for the lights that were added.

    The artist's groups stay; ours are replaced.

    Returns:
        Names of the groups; a pass is named "Combined_" and its group.
    """
    remove_light_groups(scene, layer)
    layer[LIGHT_GROUPS] = "[]"
    add_to_groups(scene)
    return list(json.loads(layer[LIGHT_GROUPS]))


def add_to_groups(scene: bpy.types.Scene) -> None:
    """Put lights that came later, and are in no group, into the groups of view layers that have ours."""
    world = result_world(scene)
    for layer in [layer for layer in scene.view_layers if has_light_groups(layer)]:
        names = list(json.loads(layer[LIGHT_GROUPS]))
        # In an EXR file, dots separate the names of layers, passes and channels.
        wanted = {
            item: item.name.replace(".", "_") if is_fixture(item) else NEW_LIGHTS for item in lights_of(scene)
        }
        lights = [(light, name) for item, name in wanted.items() for light in (item, *fixture_lights(item))]
        for each, name in [(world, ENVIRONMENT)] * (world is not None) + lights:
            if each.lightgroup not in layer.lightgroups:
                each.lightgroup = name
            if each.lightgroup == name and name not in names:
                names.append(_add(layer, name))
        layer[LIGHT_GROUPS] = json.dumps(names)


def remove_light_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    """Remove the groups that `make_light_groups` added, if any."""
    if not has_light_groups(layer):
        return
    names = set(json.loads(layer[LIGHT_GROUPS]))
    for item in scene.objects:
        if is_our_light(item) and item.lightgroup in names:
            item.lightgroup = ""
    world = result_world(scene)
    if world is not None and world.lightgroup in names:
        world.lightgroup = ""
    for name in names:
        _remove(scene, layer, name)
    remove_marks(layer, LIGHT_GROUPS)


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
    layer.active_lightgroup_index = index  # Blender 4.2 has only the operator
    with bpy.context.temp_override(scene=scene, view_layer=layer):
        bpy.ops.scene.view_layer_remove_lightgroup()
