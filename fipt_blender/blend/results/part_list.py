"""The list of parts in the panel: what it shows, the adjustments of its rows, and the faces of a part.

The adjustments themselves are in the materials; the list has none of its own.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.errors import FiptError
from ...core.run.parts import read_parts
from ...core.run.run_files import read_room
from ...core.run.runfolder import RunFolder
from ..color_spaces import to_scene_linear
from ..marks import PART, has_results, room_with_results
from ..own_materials import own_materials
from ..ray_hits import surface_on_ray
from ..room.mesh_arrays import corner_vertices, polygon_sizes, polygon_slots
from ..room.originals import estimated_meshes, result_meshes
from . import adjust
from .materials import materials_by_part, result_materials, slot_estimates

_UNKNOWN = (0.5, 0.5, 0.5)


def note_parts(scene: bpy.types.Scene, run: RunFolder) -> None:
    """List the parts that have faces in the scene's results, those that most pixels saw first."""
    settings = scene.fipt.materials
    room = read_room(run)
    faces = _face_counts(scene)
    active = settings.active_part_key()
    parts = [
        part for part in read_parts(run, room.triangle_object, room.objects).parts if faces.get(part.key)
    ]
    settings.parts.clear()
    for part in sorted(parts, key=lambda part: -part.pixels):
        row = settings.parts.add()
        row.name, row.key, row.unit = part.name, part.key, part.unit
        row.class_name, row.faces, row.pixels = part.class_name or "", faces[part.key], part.pixels
        row.known = part.base_color is not None
        row.base_color = to_scene_linear(part.base_color or _UNKNOWN)
        row.roughness, row.metallic = part.roughness or 0.0, part.metallic or 0.0
        row.confidence = part.confidence or (0.0, 0.0, 0.0)
    keys = [row.key for row in settings.parts]
    settings.active_part = keys.index(active) if active in keys else 0


def _face_counts(scene: bpy.types.Scene) -> dict[str, int]:
    """How many faces each part has, by its key."""
    counts: dict[str, int] = {}
    for mesh in result_meshes(room_with_results(scene)):
        seen = np.bincount(polygon_slots(mesh), minlength=len(mesh.materials))[: len(mesh.materials)]
        for key, count in zip(_slot_parts(mesh), seen, strict=True):
            if key and count:
                counts[key] = counts.get(key, 0) + int(count)
    return counts


def _slot_parts(mesh: bpy.types.Mesh) -> list[str]:
    """The key of the part of each slot, "" for the artist's materials that were kept."""
    return ["" if material is None else str(material.get(PART, "")) for material in slot_estimates(mesh)]


def part_materials(scene: bpy.types.Scene, key: str) -> list[bpy.types.Material]:
    """The materials of a part in a scene: one, unless the artist has copied it."""
    materials = result_materials(estimated_meshes(scene))
    return materials_by_part(materials).get(key, [])


def adjustment(scene: bpy.types.Scene, key: str) -> adjust.Adjustment:
    """The adjustment of a part."""
    return next(map(adjust.read, part_materials(scene, key)), adjust.NO_ADJUSTMENT)


def set_adjustment(scene: bpy.types.Scene, key: str, **changes: float) -> None:
    """Change values of a part's adjustment in all its materials."""
    own_materials(scene)
    materials = part_materials(scene, key)
    if materials:
        values = replace(adjust.read(materials[0]), **changes)
        for material in materials:
            adjust.write(material, values)


def reset_adjustments(scene: bpy.types.Scene, keys: Collection[str]) -> int:
    """Remove the adjustments of parts; returns how many parts had one."""
    own_materials(scene)
    changed = 0
    for key in keys:
        if adjustment(scene, key) != adjust.NO_ADJUSTMENT:
            changed += 1
            for material in part_materials(scene, key):
                adjust.write(material, adjust.NO_ADJUSTMENT)
    return changed


def select_faces(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, key: str) -> list[bpy.types.Object]:
    """Select the faces of a part, and the objects that have some; nothing else stays selected.

    Args:
        scene: in Object Mode; its results are shown.
        layer: the view layer in which the objects are selected.
        key: of the part.

    Returns:
        The selected objects, the one with the most of these faces active.
    """
    found: list[tuple[int, bpy.types.Object]] = []
    for item in room_with_results(scene):
        if item.data is None or item.name not in layer.objects:
            continue
        mesh = item.data
        slots = np.array([part == key for part in _slot_parts(mesh)] or [False])
        chosen = slots[np.minimum(polygon_slots(mesh), len(slots) - 1)]
        if chosen.any():
            select_polygons(mesh, chosen)
            found.append((int(chosen.sum()), item))
    if not found:
        raise FiptError("part-missing.select-faces")
    for item in layer.objects:
        if item.select_get(view_layer=layer):
            item.select_set(False, view_layer=layer)
    for _, item in found:
        item.select_set(True, view_layer=layer)
    layer.objects.active = max(found, key=lambda pair: pair[0])[1]
    return [item for _, item in found]


def select_polygons(mesh: bpy.types.Mesh, chosen: np.ndarray) -> None:
    """Select these polygons ((P,) bool) with their edges and vertices, and nothing else."""
    corners = np.repeat(chosen, polygon_sizes(mesh))
    edges = np.empty(len(mesh.loops), np.int32)
    if len(edges):
        mesh.attributes[".corner_edge"].data.foreach_get("value", edges)
    for index, elements in ((corner_vertices(mesh), mesh.vertices), (edges, mesh.edges)):
        selected = np.zeros(len(elements), bool)
        selected[index[corners]] = True
        elements.foreach_set("select", selected)
    mesh.polygons.foreach_set("select", chosen)
    mesh.update()


def part_under(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    origin: Vector,
    direction: Vector,
    skip_backs: bool = False,
) -> str:
    """The key of the part that a ray hits, "" where it hits no estimated surface.

    Args:
        scene, depsgraph, origin, direction, skip_backs: as for `hits`.
    """
    found = surface_on_ray(scene, depsgraph, origin, direction, skip_backs)
    if found is None or not has_results(found[0]):
        return ""
    item, face, _ = found
    keys = _slot_parts(item.data)
    slot = item.evaluated_get(depsgraph).data.polygons[face].material_index
    return keys[min(slot, len(keys) - 1)] if keys else ""
