"""Blender's objects to room.npz and room.json, in slices. The meshes are evaluated, modifiers included."""

from __future__ import annotations

import filecmp
import itertools
from collections.abc import Iterable
from dataclasses import fields, replace

import bpy
import numpy as np

from ...bridge.step import Slices
from ...core.run.contents import RoomNames
from ...core.run.errors import FiptError
from ...core.run.kinds import as_matrix
from ...core.run.run_files import RoomArrays, RoomMesh
from ...core.run.runfolder import RunFolder, atomic_path, write_json
from ...core.run.stage_settings import chosen
from ..marks import OBJECT_ID, is_exact, object_id
from ..slices import find_object
from .mesh_arrays import (
    corner_normals,
    corner_vertices,
    is_mirrored,
    polygon_slots,
    transform_points,
    triangle_loops,
    vertex_positions,
)
from .originals import original_shown

# Triangles whose normals one slice computes.
_CHUNK = 1 << 15


def export_room(
    objects: Iterable[bpy.types.Object], run: RunFolder, parts: str = "auto", completed: bool = False
) -> Slices[RoomMesh]:
    """Write the objects' triangles to the run folder; of objects with results, the original mesh.

    Results of another room are deleted.

    Args:
        objects: objects other than meshes are skipped.
        run: the run folder; room.npz and room.json are written.
        parts: source of the part labels, of `core.capture.options.PART_SOURCES`; the engine resolves "auto".
        completed: the engine adds nothing to a scan.
    """
    room = yield from collect_room(objects)
    ids = tuple(give_ids(room.objects))
    room = replace(room, object_ids=ids, parts=parts, completed=completed)
    if not len(room.triangles):
        raise FiptError("mesh-empty.export-room")
    with atomic_path(run.room_npz) as temporary:
        arrays = vars(chosen(room, RoomArrays)).items()
        np.savez(temporary, **{name: array for name, array in arrays if array is not None})
        if run.room_npz.is_file() and not filecmp.cmp(temporary, run.room_npz, shallow=False):
            run.drop_results()
    write_json(run.room_json, chosen(room, RoomNames))
    return room


def collect_room(objects: Iterable[bpy.types.Object]) -> Slices[RoomMesh]:
    """The triangles of mesh objects in world space, without writing anything."""
    # Names, since an undo between two slices may replace every object.
    names = [item.name for item in objects if item.type == "MESH"]
    # All at once, since each change redraws the viewport.
    fresh_depsgraph([bpy.data.objects[name] for name in names])
    yield None
    material_ids: dict[str, int] = {}
    kinds = [item.name for item in fields(RoomArrays) if item.name != "triangle_exact"]
    object_arrays: dict[str, list[np.ndarray]] = {kind: [] for kind in kinds}
    vertex_count = 0
    for index, name in enumerate(names):
        arrays = yield from _object_slices(name, material_ids)
        arrays["triangles"] += vertex_count
        arrays["triangle_object"] = np.full(len(arrays["triangles"]), index, np.int32)
        vertex_count += len(arrays["vertices"])
        for key, values in arrays.items():
            object_arrays[key].append(values)
    empty = {
        "vertices": np.zeros((0, 3), np.float32),
        "triangles": np.zeros((0, 3), np.int32),
        "corner_normals": np.zeros((0, 3, 3), np.float32),
    }
    joined = {
        kind: np.concatenate([empty.get(kind, np.zeros(0, np.int32)), *object_arrays[kind]]) for kind in kinds
    }
    exact = np.array([is_exact(find_object(name)) for name in names], bool)
    marked = exact[joined["triangle_object"]] if exact.any() else None
    return RoomMesh(
        **joined,
        triangle_exact=marked,
        objects=tuple(names),
        materials=tuple(material_ids),
        matrices=tuple(as_matrix(find_object(name).matrix_world) for name in names),
    )


def give_ids(names: Iterable[str]) -> list[str]:
    """The ids of objects, given by name; objects without an id and copies of others get one.

    An id is the name at the first export: the same room exported from two files has the same ids.
    """
    names = list(names)
    taken = {object_id(item) for item in bpy.data.objects if OBJECT_ID in item}
    ids: dict[str, str] = {}
    used: set[str] = set()
    # A copy has its original's id; the object that was named so first keeps it.
    for name in sorted(names, key=lambda name: object_id(bpy.data.objects[name]) != name):
        item = bpy.data.objects[name]
        own = object_id(item)
        if own in used or (OBJECT_ID not in item and own in taken):
            numbered = itertools.chain([name], (f"{name} ({number})" for number in itertools.count(2)))
            own = next(text for text in numbered if text not in used | taken)
        ids[name] = own
        used.add(own)
        if item.library is None and item.get(OBJECT_ID) != own:
            item[OBJECT_ID] = own
    return [ids[name] for name in names]


def _object_slices(name: str, material_ids: dict[str, int]) -> Slices[dict[str, np.ndarray]]:
    """The arrays of one object except `triangle_object`; `triangles` index its own vertices.

    Args:
        name: name of the object.
        material_ids: index of each material by name; new ones are added.
    """
    item = find_object(name)
    with original_shown(item):
        evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        names = [slot.material.name if slot.material else "" for slot in evaluated.material_slots]
        matrix = np.array(evaluated.matrix_world, np.float64)
        mesh = evaluated.to_mesh()
        corners = corner_normals(mesh)
        loops, polygons = triangle_loops(mesh, is_mirrored(evaluated))
        vertices = transform_points(vertex_positions(mesh), matrix)
        triangles = corner_vertices(mesh)[loops]
        slots = polygon_slots(mesh)[polygons]
        evaluated.to_mesh_clear()
    ids = [material_ids.setdefault(name, len(material_ids)) if name else -1 for name in names]
    materials = np.array(ids or [-1], np.int32)
    normals = [np.zeros((0, 3, 3), np.float32)]
    for start in range(0, len(loops), _CHUNK):
        yield None
        chunk = slice(start, start + _CHUNK)
        normals.append(_world_normals(corners, matrix, loops[chunk], vertices[triangles[chunk]]))
    return {
        "vertices": vertices.astype(np.float32),
        "triangles": triangles,
        "corner_normals": np.concatenate(normals),
        "triangle_material": materials[np.clip(slots, 0, len(materials) - 1)],
        "triangle_polygon": polygons,
    }


def fresh_depsgraph(objects: Iterable[bpy.types.Object]) -> bpy.types.Depsgraph:
    """The dependency graph with the objects' meshes evaluated again.

    Blender misses some changes that scripts make to a mesh (removing a UV layer, for example).
    """
    for item in objects:
        item.data.update_tag()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return depsgraph


def _world_normals(
    normals: np.ndarray, matrix: np.ndarray, loops: np.ndarray, positions: np.ndarray
) -> np.ndarray:
    """Unit shading normals (T,3,3) in the world; where one is zero the face normal, else straight up.

    Args:
        normals: (L,3) of the mesh's face corners, in its own space.
        matrix: its world matrix.
        loops: (T,3) face corners of the triangles.
        positions: (T,3,3) positions of these corners in the world.
    """
    linear = matrix[:3, :3]
    # The cofactor matrix transforms normals like the inverse transpose, and exists for flat scales too.
    cofactor = np.stack(
        [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    )
    sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
    world = normals[loops].astype(np.float64) @ cofactor.T * sign
    face = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    face_length = np.linalg.norm(face, axis=1, keepdims=True)
    face = np.where(face_length > 0.0, face / np.maximum(face_length, 1e-300), [0.0, 0.0, 1.0])
    length = np.linalg.norm(world, axis=2, keepdims=True)
    usable = np.isfinite(length) & (length > 1e-20)
    return np.where(usable, world / np.where(usable, length, 1.0), face[:, None]).astype(np.float32)
