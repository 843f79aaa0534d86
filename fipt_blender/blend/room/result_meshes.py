"""Result meshes: new meshes made from the room's objects as they are evaluated without results;
the cleaned vertices of scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ...core.run.run_files import Geometry, RoomMesh
from ..marks import OBJECT_ID, has_results, object_id
from .exporting import fresh_depsgraph
from .mesh_arrays import corner_vertices, is_mirrored, transform_points, triangle_loops, vertex_positions
from .originals import modifiers_in_result, original_shown


def match_objects(room: RoomMesh, objects: Iterable[bpy.types.Object]) -> list[str | None]:
    """The present names of a run's objects, in the run's order; None for those that are missing.

    An object is found by its id, which it keeps when it is renamed, else by its name.

    Args:
        room: the run's room.
        objects: the scene's room.
    """
    present = {item.name: object_id(item) for item in objects if item.type == "MESH"}
    by_id: dict[str, list[str]] = {}
    for name, identity in present.items():
        by_id.setdefault(identity, []).append(name)
    matches: list[str | None] = []
    for name, identity in zip(room.objects, room.object_ids, strict=True):
        names = by_id.get(identity, [])  # several where the artist has duplicated it
        matches.append(name if name in names else names[0] if names else None)
    for index, name in enumerate(room.objects):
        others = name in present and name not in matches and present[name] not in room.object_ids
        if matches[index] is None and others:
            matches[index] = name
    if room.objects and not any(matches):
        raise FiptError("room-changed.match-objects", objects=list_names(room.objects))
    return matches


def list_names(names: Sequence[str]) -> str:
    """The first names of a list in quotes, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(f"'{name}'" for name in names[:3]) + more


def copied_objects(
    room: RoomMesh, matches: Sequence[str | None], objects: Iterable[bpy.types.Object]
) -> list[tuple[int, str]]:
    """Index in the room and name of the objects that the artist has copied or separated from matched ones."""
    index = {name: number for number, name in enumerate(room.object_ids)}
    others = [item for item in objects if item.name not in matches and OBJECT_ID in item]
    return [(index[object_id(item)], item.name) for item in others if object_id(item) in index]


def make_mesh(room: RoomMesh, index: int, item: bpy.types.Object) -> tuple[bpy.types.Mesh, list[str]]:
    """A new result mesh for an object of the room: its own mesh with the modifiers of the export.

    Args:
        room: the run's room.
        index: index of the object in the room.
        item: the object; it is not changed.

    Returns:
        The mesh, and the names of the modifiers that are part of it: the first ones.
    """
    exported = room.triangle_polygon[room.triangle_object == index]
    for mesh, modifiers in evaluations(item):
        _, polygons = triangle_loops(mesh, is_mirrored(item))
        if np.array_equal(polygons, exported):
            return mesh, modifiers
        bpy.data.meshes.remove(mesh)
    raise FiptError("room-changed.make-mesh", name=item.name, number_of_exported=len(exported))


def evaluations(item: bpy.types.Object) -> Iterator[tuple[bpy.types.Mesh, list[str]]]:
    """An object's own mesh as new meshes: with all of its modifiers, then without the last ones.

    The first one has the modifiers of an earlier result, if there is one: others came later.

    Yields:
        The mesh, which the caller removes or keeps, and the names of the modifiers that are part of it.
    """
    with original_shown(item):
        names = [modifier.name for modifier in item.modifiers]
        present = [modifier.name for modifier in item.modifiers if modifier.show_viewport]
    earlier = modifiers_in_result(item)
    counts = [sum(name in earlier for name in present)] if has_results(item) else []
    for count in dict.fromkeys([*counts, *range(len(present), -1, -1)]):
        with original_shown(item):
            for name in present[count:]:
                item.modifiers[name].show_viewport = False
            depsgraph = fresh_depsgraph([item])
            mesh = bpy.data.meshes.new_from_object(
                item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
            )
            for slot_index, slot in enumerate(item.material_slots):
                mesh.materials[slot_index] = slot.material  # it may be linked to the object
            for name in present[count:]:
                item.modifiers[name].show_viewport = True
        live = present[count:]
        yield mesh, names[: names.index(live[0])] if live else names


def clean_result_mesh(
    mesh: bpy.types.Mesh, item: bpy.types.Object, room: RoomMesh, index: int, geometry: Geometry
) -> None:
    """Move the vertices of a result mesh to those of the cleaned scan, and set its shading normals.

    Args:
        mesh: the new result mesh of `item`, with the triangles that were exported.
        item: the object; it is not changed.
        room, index: the run's room, and the object's index in it.
        geometry: cleaned, of the scan.
    """
    of_object = room.triangle_object == index
    loops, _ = triangle_loops(mesh, is_mirrored(item))
    matrix = np.array(item.matrix_world, np.float64)
    positions = vertex_positions(mesh)
    corners = geometry.vertices[room.triangles[of_object].ravel()].astype(np.float64)
    positions[corner_vertices(mesh)[loops.ravel()]] = transform_points(corners, np.linalg.inv(matrix))
    mesh.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    # Normals transform by the inverse transpose, back by the transpose.
    local = geometry.corner_normals[of_object].reshape(-1, 3).astype(np.float64) @ matrix[:3, :3]
    normals = np.zeros((len(mesh.loops), 3))
    normals[loops.ravel()] = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    mesh.shade_smooth()
    mesh.normals_split_custom_set(normals)
    mesh.update()
