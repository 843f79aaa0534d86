"""Materials of the artist in place of those estimated of parts, and the way back.

An estimated material names what has replaced it, so that the choice is kept with the file and by Apply
Results. The result meshes keep the estimated material of each slot, whatever the slot shows.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..marks import ESTIMATE, PART, REPLACEMENT, remove_marks
from ..own_materials import own_materials
from ..room.originals import estimated_meshes, shows_original
from .materials import slot_estimates
from .part_list import part_materials
from .tiling import lay_out

SHOWS_REPLACEMENTS = "ESTIMATED"  # the maps are those of the estimate


def wanted(estimate: bpy.types.Material) -> bpy.types.Material:
    """The material that a part shows: its replacement, or its estimate without one."""
    return estimate.get(REPLACEMENT) or estimate


def replacement(scene: bpy.types.Scene, key: str) -> bpy.types.Material | None:
    """What has replaced the estimated material of a part; None for the estimate."""
    return next((each.get(REPLACEMENT) for each in part_materials(scene, key)), None)


def replace_part(scene: bpy.types.Scene, key: str, material: bpy.types.Material | None) -> None:
    """Give a whole part a material of the artist, or its estimate again (None)."""
    own_materials(scene)
    for estimate in part_materials(scene, key):
        if material is None or material == estimate:
            remove_marks(estimate, REPLACEMENT)
        else:
            estimate[REPLACEMENT] = material
    show_replacements(scene, scene.fipt.materials.shown)


def fill_slots(mesh: bpy.types.Mesh, materials: Iterable[bpy.types.Material | None]) -> None:
    """Give a new result mesh its slots; replaced estimates are kept with it."""
    remove_marks(mesh, *[key for key in mesh.keys() if key.startswith(ESTIMATE.format(""))])
    mesh.materials.clear()
    for index, material in enumerate(materials):
        if material is not None and PART in material:
            mesh[ESTIMATE.format(index)] = material
            material = wanted(material)
        mesh.materials.append(material)


def show_replacements(scene: bpy.types.Scene, shown: str) -> None:
    """Put the replacements into the slots of the scene's results, or the estimates while a map is shown."""
    for mesh in estimated_meshes(scene):
        for index, estimate in enumerate(slot_estimates(mesh)):
            if estimate is None:
                continue
            material = wanted(estimate) if shown == SHOWS_REPLACEMENTS else estimate
            if mesh.materials[index] != material:
                mesh[ESTIMATE.format(index)] = estimate
                mesh.materials[index] = material
    lay_out(scene)


def adopt(scene: bpy.types.Scene, items: Iterable[bpy.types.Object]) -> list[str]:
    """Give whole parts the materials that slots of these objects have got; returns the keys of the parts.

    The result depends on the slots alone, so that it is right after undo and redo, too.
    """
    changed: list[str] = []
    if scene.fipt.materials.shown != SHOWS_REPLACEMENTS:
        return changed
    for item in items:
        if shows_original(item):
            continue
        mesh = item.data
        for index, estimate in enumerate(slot_estimates(mesh)):
            slot = item.material_slots[index]
            material = slot.material
            if slot.link == "OBJECT":  # by the preference of where materials are linked to
                slot.material = None
                slot.link = "DATA"
            if estimate is None or material is None or material == wanted(estimate):
                continue
            key = str(estimate[PART])
            replace_part(scene, key, None if material == estimate else material)
            changed.append(key)
    return changed
