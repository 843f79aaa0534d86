# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's own meshes and materials: set aside before ours take their place, brought back exactly.

Every object of the room gets a mesh of its own (its evaluated mesh, so that instances and modifiers
don't share texels); the original mesh with its slots, UVs and material indices is never written to.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import bpy
import numpy as np

ORIGINAL_MESH = "fipt_original_mesh"
ORIGINAL_STATE = "fipt_original_state"
OBJECT_SLOT = "fipt_original_slot_{}"
OWN_MESH = "fipt_own_mesh"  # ours, while the original is shown
FIXTURE_SOURCES = "fipt_sources"
POLYGON_ATTRIBUTE = "fipt_polygon"


def number_polygons(mesh: bpy.types.Mesh) -> None:
    """Let a mesh's faces remember their indices (attribute ``fipt_polygon``) when some are split off."""
    attribute = mesh.attributes.new(POLYGON_ATTRIBUTE, "INT", "FACE")
    attribute.data.foreach_set("value", np.arange(len(mesh.polygons), dtype=np.int32))


def original_polygons(mesh: bpy.types.Mesh) -> np.ndarray:
    """For each polygon of one of our meshes its index when the room was exported, (P,) i32."""
    index = np.empty(len(mesh.polygons), np.int32)
    mesh.attributes[POLYGON_ATTRIBUTE].data.foreach_get("value", index)
    return index


def has_results(item: bpy.types.Object) -> bool:
    """Whether an object carries a mesh of ours, shown or not."""
    return ORIGINAL_MESH in item


def shows_original(item: bpy.types.Object) -> bool:
    """Whether an object shows the artist's mesh."""
    return ORIGINAL_MESH not in item or OWN_MESH in item


def own_mesh(item: bpy.types.Object) -> bpy.types.Mesh | None:
    """Our mesh of an object, shown or not."""
    return item.get(OWN_MESH, item.data) if ORIGINAL_MESH in item else None


def set_own_mesh(item: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    """Show a mesh of ours on an object; an earlier one of ours is removed.

    The artist's mesh, slots and modifiers are remembered, the modifiers switched off.
    """
    old = own_mesh(item)
    if shows_original(item):
        _set_aside(item)
    _put(item, mesh)
    if OWN_MESH in item:
        del item[OWN_MESH]
    if old is not None and old != mesh and old.users == 0:
        bpy.data.meshes.remove(old)
    mesh.name = f"{item[ORIGINAL_MESH].name} FIPT"


def show_original(item: bpy.types.Object, on: bool) -> None:
    """Show the artist's mesh with his materials and modifiers, or ours again; without ours do nothing."""
    if ORIGINAL_MESH not in item:
        return
    if on and OWN_MESH not in item:
        item[OWN_MESH] = item.data
        _bring_back(item)
    elif not on and OWN_MESH in item:
        ours = item[OWN_MESH]
        _set_aside(item)  # anew: the artist may have worked on it
        _put(item, ours)
        del item[OWN_MESH]


def _set_aside(item: bpy.types.Object) -> None:
    _forget_slots(item)
    state = {
        "modifiers": [[each.name, each.show_viewport, each.show_render] for each in item.modifiers],
        "links": [slot.link for slot in item.material_slots],
        "active_slot": item.active_material_index,
    }
    for index, slot in enumerate(item.material_slots):
        if slot.link == "OBJECT" and slot.material is not None:
            item[OBJECT_SLOT.format(index)] = slot.material
            # Blender does not count a slot's user off when another mesh takes the slot away.
            slot.material = None
    item[ORIGINAL_MESH] = item.data
    item[ORIGINAL_STATE] = json.dumps(state)


def _put(item: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    for modifier in item.modifiers:
        modifier.show_viewport = modifier.show_render = False
    item.data = mesh
    for slot in item.material_slots:
        slot.link = "DATA"


def _bring_back(item: bpy.types.Object) -> None:
    state = json.loads(item[ORIGINAL_STATE])
    item.data = item[ORIGINAL_MESH]
    for name, show_viewport, show_render in state["modifiers"]:
        if name in item.modifiers:
            item.modifiers[name].show_viewport = show_viewport
            item.modifiers[name].show_render = show_render
    for index, (slot, link) in enumerate(zip(item.material_slots, state["links"], strict=False)):
        slot.link = link
        if link == "OBJECT":
            slot.material = item.get(OBJECT_SLOT.format(index))
    item.active_material_index = state["active_slot"]


def _forget_slots(item: bpy.types.Object) -> None:
    for key in [key for key in item.keys() if key.startswith(OBJECT_SLOT.format(""))]:
        del item[key]


def restore_original(objects: Iterable[bpy.types.Object]) -> list[str]:
    """Bring back the artist's meshes, slots and modifiers, and remove the fixtures split off them.

    Returns:
        The names of the objects that were changed back.
    """
    restored = []
    unused = []
    for item in objects:
        ours = own_mesh(item)
        if ours is None:
            continue
        if not shows_original(item):
            _bring_back(item)
        _forget_slots(item)
        for key in (ORIGINAL_MESH, ORIGINAL_STATE, OWN_MESH):
            if key in item:
                del item[key]
        if ours.users == 0:
            unused.append(ours)
        restored.append(item.name)
    bpy.data.batch_remove(unused)
    remove_fixtures(set(restored))
    return restored


def remove_fixtures(sources: set[str]) -> None:
    """Remove the fixtures split off objects of these names, and the lights made of them."""
    for name in [item.name for item in bpy.data.objects if FIXTURE_SOURCES in item]:
        item = bpy.data.objects[name]
        if sources & set(json.loads(item[FIXTURE_SOURCES])):
            _remove_fixture(item)


def _remove_fixture(item: bpy.types.Object) -> None:
    for child in item.children:
        if FIXTURE_SOURCES not in child:  # the artist's own, hung onto the fixture
            matrix = child.matrix_world.copy()
            child.parent = None
            child.matrix_world = matrix
    data = item.data
    materials = [each for each in data.materials if each is not None] if item.type == "MESH" else []
    bpy.data.objects.remove(item)
    for block in (data, *materials):
        if block.users == 0:
            bpy.data.batch_remove([block])
