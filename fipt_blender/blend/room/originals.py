# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's original meshes and materials: set aside while result meshes are shown, restored exactly.

Every object of the room gets a result mesh of its own, made from its evaluated mesh, so that instances and
modifiers don't share texels. The original mesh with its slots, UVs and material indices is never written to.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from ..marks import (
    FIXTURE_SOURCES,
    OBJECT_SLOT,
    ORIGINAL_MESH,
    ORIGINAL_STATE,
    RESULT_MESH,
    has_results,
    is_split_off,
    object_id,
    remove_marks,
)

POLYGON_ATTRIBUTE = "fipt_polygon"


def number_polygons(mesh: bpy.types.Mesh) -> None:
    """Store each polygon's index in the attribute ``fipt_polygon``, before polygons are split off the mesh.

    Meshes that keep all polygons do without, since the attribute has a share in the size of the file.
    """
    attribute = mesh.attributes.new(POLYGON_ATTRIBUTE, "INT", "FACE")
    attribute.data.foreach_set("value", np.arange(len(mesh.polygons), dtype=np.int32))


def original_polygons(mesh: bpy.types.Mesh) -> np.ndarray:
    """Index that each polygon of a result mesh had when the room was exported, (P,) i32."""
    attribute = mesh.attributes.get(POLYGON_ATTRIBUTE)
    if attribute is None:
        return np.arange(len(mesh.polygons), dtype=np.int32)
    index = np.empty(len(mesh.polygons), np.int32)
    attribute.data.foreach_get("value", index)
    return index


def shows_original(item: bpy.types.Object) -> bool:
    """Whether an object shows the artist's mesh."""
    return not has_results(item) or RESULT_MESH in item


def result_mesh(item: bpy.types.Object) -> bpy.types.Mesh | None:
    """The result mesh of an object, shown or not."""
    return item.get(RESULT_MESH, item.data) if has_results(item) else None


def result_meshes(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Mesh]:
    """The result meshes of those objects that have one."""
    return [mesh for mesh in map(result_mesh, objects) if mesh is not None]


def set_result_mesh(item: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    """Show a result mesh on an object; an earlier result mesh is removed.

    The artist's mesh, slots and modifiers are stored with the object, and its modifiers switched off.
    """
    old = result_mesh(item)
    if shows_original(item):
        _set_aside(item)
    _show_mesh(item, mesh)
    remove_marks(item, RESULT_MESH)
    if old is not None and old != mesh and old.users == 0:
        bpy.data.meshes.remove(old)
    mesh.name = f"{item[ORIGINAL_MESH].name} FIPT"


def show_original(item: bpy.types.Object, on: bool) -> None:
    """Show the artist's mesh, materials and modifiers, or the result again, if there is one."""
    if not has_results(item):
        return
    if on and RESULT_MESH not in item:
        item[RESULT_MESH] = item.data
        _bring_back(item)
    elif not on and RESULT_MESH in item:
        mesh = item[RESULT_MESH]
        _set_aside(item)  # again, since the artist may have changed the original
        _show_mesh(item, mesh)
        del item[RESULT_MESH]


@contextmanager
def original_shown(item: bpy.types.Object) -> Iterator[None]:
    """Show the artist's mesh for the length of the block."""
    result_was_shown = not shows_original(item)
    show_original(item, True)
    try:
        yield
    finally:
        if result_was_shown:
            show_original(item, False)


def _set_aside(item: bpy.types.Object) -> None:
    _delete_slots(item)
    state = {
        "modifiers": [
            [modifier.name, modifier.show_viewport, modifier.show_render] for modifier in item.modifiers
        ],
        "links": [slot.link for slot in item.material_slots],
        "active_slot": item.active_material_index,
    }
    for index, slot in enumerate(item.material_slots):
        if slot.link == "OBJECT" and slot.material is not None:
            item[OBJECT_SLOT.format(index)] = slot.material
            # Blender keeps counting the slot as a user when another mesh takes the slot away.
            slot.material = None
    item[ORIGINAL_MESH] = item.data
    item[ORIGINAL_STATE] = json.dumps(state)


def _show_mesh(item: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
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


def _delete_slots(item: bpy.types.Object) -> None:
    remove_marks(item, *[key for key in item.keys() if key.startswith(OBJECT_SLOT.format(""))])


def restore_original(objects: Iterable[bpy.types.Object]) -> list[str]:
    """Bring back the artist's meshes, slots and modifiers, and remove the fixtures split off these objects.

    Returns:
        The names of the objects that were restored.
    """
    restored = []
    ids = set()
    unused = []
    for item in objects:
        mesh = result_mesh(item)
        if mesh is None:
            continue
        if not shows_original(item):
            _bring_back(item)
        _delete_slots(item)
        remove_marks(item, ORIGINAL_MESH, ORIGINAL_STATE, RESULT_MESH)
        if mesh.users == 0:
            unused.append(mesh)
        restored.append(item.name)
        ids.add(object_id(item))
    bpy.data.batch_remove(unused)
    remove_fixtures(ids)
    return restored


def remove_fixtures(sources: set[str]) -> None:
    """Remove the fixtures split off objects with these ids, and the lights that stand for the fixtures."""
    for name in [item.name for item in bpy.data.objects if is_split_off(item)]:
        item = bpy.data.objects[name]
        if sources & set(json.loads(item[FIXTURE_SOURCES])):
            _remove_fixture(item)


def _remove_fixture(item: bpy.types.Object) -> None:
    for child in item.children:
        if not is_split_off(child):  # parented to the fixture by the artist
            matrix = child.matrix_world.copy()
            child.parent = None
            child.matrix_world = matrix
    data = item.data
    materials = (
        [material for material in data.materials if material is not None] if item.type == "MESH" else []
    )
    bpy.data.objects.remove(item)
    for block in (data, *materials):
        if block.users == 0:
            bpy.data.batch_remove([block])
