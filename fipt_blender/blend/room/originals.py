"""The artist's original meshes and materials: set aside while result meshes are shown, restored exactly.

Every object of the room gets a result mesh of its own, made from its evaluated mesh, so that instances and
modifiers don't share texels. The original mesh with its slots, UVs and material indices is never written to.
Modifiers that are part of the result mesh are switched off; others, which came later, stay as they are.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy

from ..marks import (
    BASE,
    FIXTURE_SOURCES,
    OBJECT_ID,
    OBJECT_SLOT,
    ORIGINAL_MESH,
    ORIGINAL_STATE,
    RESULT_MESH,
    filled_surfaces,
    has_results,
    is_split_off,
    object_id,
    remove_marks,
    room_with_results,
)
from .mesh_digest import is_edited


def shows_original(item: bpy.types.Object) -> bool:
    """Whether an object shows the artist's mesh."""
    return not has_results(item) or RESULT_MESH in item


def result_mesh(item: bpy.types.Object) -> bpy.types.Mesh | None:
    """The result mesh of an object, shown or not."""
    return item.get(RESULT_MESH, item.data) if has_results(item) else None


def result_meshes(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Mesh]:
    """The result meshes of those objects that have one."""
    return [mesh for mesh in map(result_mesh, objects) if mesh is not None]


def estimated_meshes(scene: bpy.types.Scene) -> list[bpy.types.Mesh]:
    """The meshes that have estimated materials: the result meshes, and what completes the room."""
    return [*result_meshes(room_with_results(scene)), *(item.data for item in filled_surfaces(scene))]


def set_result_mesh(
    item: bpy.types.Object, mesh: bpy.types.Mesh, modifiers: Collection[str] | None = None
) -> None:
    """Show a result mesh on an object; an earlier result mesh is removed.

    The artist's mesh and slots are stored with the object.

    Args:
        item: the object.
        mesh: its new result mesh.
        modifiers: names of those that are part of the mesh; by default those of the earlier result mesh.
    """
    old = result_mesh(item)
    if modifiers is None:
        modifiers = modifiers_in_result(item)
    if shows_original(item):
        _set_aside(item, modifiers)
    else:
        state = json.loads(item[ORIGINAL_STATE])
        _switch_on(item, state)
        item[ORIGINAL_STATE] = json.dumps({**state, "modifiers": _visibility(item, modifiers)})
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
        _set_aside(item, modifiers_in_result(item))  # again: the artist may have changed the original
        _show_mesh(item, mesh)
        del item[RESULT_MESH]


@contextmanager
def original_shown(item: bpy.types.Object) -> Iterator[None]:
    """Show the artist's mesh for the length of the block; Blender evaluates no hidden objects."""
    result_was_shown, hidden = not shows_original(item), item.hide_viewport
    if hidden:
        item.hide_viewport = False
    show_original(item, True)
    try:
        yield
    finally:
        if result_was_shown:
            show_original(item, False)
        if hidden:
            item.hide_viewport = True


def modifiers_in_result(item: bpy.types.Object) -> list[str]:
    """Names of the modifiers that are part of an object's result mesh."""
    return [modifier.name for modifier, *_ in _kept(item, json.loads(item.get(ORIGINAL_STATE, "{}")))]


def _kept(item: bpy.types.Object, state: dict[str, Any]) -> Iterator[tuple[bpy.types.Modifier, bool, bool]]:
    """The modifiers of a stored state with their visibility in viewports and renders."""
    found = {_modifier_id(modifier): modifier for modifier in item.modifiers}
    for key, show_viewport, show_render in state.get("modifiers", []):
        if key in found:
            yield found[key], show_viewport, show_render


def _modifier_id(modifier: bpy.types.Modifier) -> int | str:
    """What identifies a modifier when it is renamed; its name in Blender versions without ids."""
    return getattr(modifier, "persistent_uid", 0) or modifier.name


def _visibility(item: bpy.types.Object, modifiers: Collection[str]) -> list[list[Any]]:
    chosen = [each for each in item.modifiers if each.name in modifiers]
    return [[_modifier_id(each), each.show_viewport, each.show_render] for each in chosen]


def _switch_on(item: bpy.types.Object, state: dict[str, Any]) -> None:
    for modifier, show_viewport, show_render in _kept(item, state):
        modifier.show_viewport, modifier.show_render = show_viewport, show_render


def _set_aside(item: bpy.types.Object, modifiers: Collection[str]) -> None:
    _delete_slots(item)
    state = {
        "modifiers": _visibility(item, modifiers),
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
    for modifier, *_ in _kept(item, json.loads(item[ORIGINAL_STATE])):
        modifier.show_viewport = modifier.show_render = False
    item.data = mesh
    for slot in item.material_slots:
        slot.link = "DATA"


def _bring_back(item: bpy.types.Object) -> None:
    state = json.loads(item[ORIGINAL_STATE])
    item.data = item[ORIGINAL_MESH]
    _switch_on(item, state)
    for index, (slot, link) in enumerate(zip(item.material_slots, state["links"], strict=False)):
        slot.link = link
        if link == "OBJECT":
            slot.material = item.get(OBJECT_SLOT.format(index))
    item.active_material_index = state["active_slot"]


def _delete_slots(item: bpy.types.Object) -> None:
    remove_marks(item, *[key for key in item.keys() if key.startswith(OBJECT_SLOT.format(""))])


def restore_original(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[str]:
    """Bring back the artist's meshes, slots and modifiers, and remove the fixtures split off these objects.

    A result mesh that the artist has modelled stays in the file, with a fake user. What the artist has
    separated from another object stays as a hidden object.

    Args:
        scene: of the fixtures: copies of it have their own.
        objects: those without results are skipped.

    Returns:
        The names of the objects that were restored.
    """
    objects = list(objects)
    restored = []
    ids = set()
    for item in separated(objects):
        remove_marks(item, ORIGINAL_MESH, ORIGINAL_STATE, RESULT_MESH, OBJECT_ID)
        item.hide_viewport = item.hide_render = True
    unused = []
    for item in objects:
        mesh = result_mesh(item)
        if mesh is None:
            continue
        if not shows_original(item):
            _bring_back(item)
        _delete_slots(item)
        remove_marks(item, ORIGINAL_MESH, ORIGINAL_STATE, RESULT_MESH)
        if mesh.users == 0 and is_edited(mesh):
            mesh.use_fake_user = True
        elif mesh.users == 0:
            unused.append(mesh)
        restored.append(item.name)
        ids.add(object_id(item))
    bpy.data.batch_remove(unused)
    remove_fixtures(scene, ids)
    return restored


def separated(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Those objects that show modelled parts of another one: it gets the original mesh of both."""
    first: set[bpy.types.Mesh] = set()
    found = []
    for item in sorted(objects, key=lambda item: object_id(item) != item.name):
        mesh = item.get(ORIGINAL_MESH)
        if mesh in first and not shows_original(item) and is_edited(item.data):
            found.append(item)
        elif mesh is not None:
            first.add(mesh)
    return found


def remove_fixtures(scene: bpy.types.Scene, sources: set[str]) -> None:
    """Remove a scene's fixtures split off objects with these ids, and the lights that stand for them."""
    for name in [item.name for item in scene.objects if is_split_off(item)]:
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
    materials = list(data.materials) if item.type == "MESH" else []
    materials = [material for material in materials if material is not None and BASE in material]
    bpy.data.objects.remove(item)
    for block in (data, *materials):
        if block.users == 0:
            bpy.data.batch_remove([block])
