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
FIXTURE_SOURCES = "fipt_sources"
POLYGON_ATTRIBUTE = "fipt_polygon"


def make_own_mesh(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Mesh:
    """Give an object a mesh that is only ours to write; does nothing where it has one already.

    The mesh is the evaluated one with its modifiers' result; they are switched off until
    `restore_original`. Its face attribute ``fipt_polygon`` remembers the polygons' indices.
    """
    if ORIGINAL_MESH in item:
        return item.data
    mesh = bpy.data.meshes.new_from_object(
        item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
    )
    mesh.name = f"{item.data.name} FIPT"
    attribute = mesh.attributes.new(POLYGON_ATTRIBUTE, "INT", "FACE")
    attribute.data.foreach_set("value", np.arange(len(mesh.polygons), dtype=np.int32))
    state = {
        "modifiers": [[each.name, each.show_viewport, each.show_render] for each in item.modifiers],
        "links": [slot.link for slot in item.material_slots],
        "active_slot": item.active_material_index,
    }
    for index, slot in enumerate(item.material_slots):
        if slot.link == "OBJECT" and slot.material is not None:
            item[OBJECT_SLOT.format(index)] = slot.material
    item[ORIGINAL_MESH] = item.data
    item[ORIGINAL_STATE] = json.dumps(state)
    for modifier in item.modifiers:
        modifier.show_viewport = modifier.show_render = False
    item.data = mesh
    for slot in item.material_slots:
        slot.link = "DATA"
    return mesh


def original_polygons(mesh: bpy.types.Mesh) -> np.ndarray:
    """For each polygon of one of our meshes its index when the room was exported, (P,) i32."""
    index = np.empty(len(mesh.polygons), np.int32)
    mesh.attributes[POLYGON_ATTRIBUTE].data.foreach_get("value", index)
    return index


def restore_original(objects: Iterable[bpy.types.Object]) -> list[str]:
    """Bring back the artist's meshes, slots and modifiers, and remove the fixtures split off them.

    Returns:
        The names of the objects that were changed back.
    """
    restored = []
    unused = []
    for item in objects:
        if ORIGINAL_MESH not in item:
            continue
        state = json.loads(item[ORIGINAL_STATE])
        ours, original = item.data, item[ORIGINAL_MESH]
        item.data = original
        for name, show_viewport, show_render in state["modifiers"]:
            if name in item.modifiers:
                item.modifiers[name].show_viewport = show_viewport
                item.modifiers[name].show_render = show_render
        for index, (slot, link) in enumerate(zip(item.material_slots, state["links"], strict=False)):
            slot.link = link
            if link == "OBJECT":
                slot.material = item.get(OBJECT_SLOT.format(index))
        item.active_material_index = state["active_slot"]
        for index in range(len(state["links"])):
            if OBJECT_SLOT.format(index) in item:
                del item[OBJECT_SLOT.format(index)]
        del item[ORIGINAL_MESH], item[ORIGINAL_STATE]
        if ours.users == 0:
            unused.append(ours)
        restored.append(item.name)
    bpy.data.batch_remove(unused)
    _remove_fixtures(set(restored))
    return restored


def _remove_fixtures(sources: set[str]) -> None:
    for item in [each for each in bpy.data.objects if FIXTURE_SOURCES in each]:
        if sources & set(json.loads(item[FIXTURE_SOURCES])):
            mesh = item.data
            bpy.data.objects.remove(item)
            if mesh.users == 0:
                bpy.data.meshes.remove(mesh)
