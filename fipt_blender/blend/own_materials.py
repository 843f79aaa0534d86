"""Materials of a scene's own: a full copy of a scene shares those of its room and lamps with the first one.

Called before anything is written to them.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from .marks import ESTIMATE, MATERIAL, RESULT_MESH, has_estimates, is_fixture, is_our_light


def own_materials(scene: bpy.types.Scene) -> None:
    """Give a scene copies of estimated materials that other scenes use, and each lamp those of its own.

    A scene that shares surfaces of its room, as that of a picture over the photograph does, is no copy.
    """
    copies: dict[bpy.types.Material, bpy.types.Material] = {}
    if len(bpy.data.scenes) > 1:
        items = _surfaces(scene)
        rooms = [room for room in map(_surfaces, bpy.data.scenes) if room.isdisjoint(items)]
        elsewhere = _meshes(set().union(*rooms))
        for item in items:
            if item.get(RESULT_MESH) in elsewhere:
                item[RESULT_MESH] = item[RESULT_MESH].copy()
        shared = {material for mesh in elsewhere for material in _materials(mesh) if MATERIAL in material}
        for mesh in _meshes(items) - elsewhere:
            _replace(mesh, shared, copies)
    lamps = [item for item in scene.objects if is_our_light(item) and item.type == "MESH"]
    if any(material.users > 1 for item in lamps for material in _materials(item.data)):
        used: set[bpy.types.Material] = set()
        present = {item.data for item in lamps}
        for item in bpy.data.objects:
            if is_our_light(item) and item.type == "MESH" and item.data not in present:
                used |= _materials(item.data)
        for mesh in dict.fromkeys(item.data for item in lamps):
            _replace(mesh, used, {})
            used |= _materials(mesh)


def _surfaces(scene: bpy.types.Scene) -> set[bpy.types.Object]:
    """A scene's estimated objects and its fixtures."""
    return {item for item in scene.objects if has_estimates(item) or is_fixture(item)}


def _meshes(items: Iterable[bpy.types.Object]) -> set[bpy.types.Mesh]:
    """The result meshes of objects."""
    return {item.get(RESULT_MESH, item.data) for item in items}


def _materials(mesh: bpy.types.Mesh) -> set[bpy.types.Material]:
    """The materials of a mesh's slots, and the estimates that others have replaced there."""
    found = {*mesh.materials, *(mesh.get(ESTIMATE.format(index)) for index in range(len(mesh.materials)))}
    return {material for material in found if material is not None}


def _replace(
    mesh: bpy.types.Mesh,
    shared: set[bpy.types.Material],
    copies: dict[bpy.types.Material, bpy.types.Material],
) -> None:
    """Put copies in the place of shared materials; `copies` has those that there are."""

    def own(material: bpy.types.Material) -> bpy.types.Material:
        if material not in copies:
            copies[material] = material.copy()
        return copies[material]

    for index, material in enumerate(mesh.materials):
        if material in shared:
            mesh.materials[index] = own(material)
        key = ESTIMATE.format(index)
        if mesh.get(key) in shared:
            mesh[key] = own(mesh[key])
