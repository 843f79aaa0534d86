# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's objects to room.npz and room.json: one triangle soup in world space with ids.

The meshes are the evaluated ones, modifiers included. docs/architecture.md describes the arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path, read_json, write_json
from .originals import restore_original


@dataclass
class Room:
    """The arrays of room.npz and the names of room.json."""

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    triangle_object: np.ndarray
    triangle_material: np.ndarray
    triangle_polygon: np.ndarray
    objects: list[str]
    materials: list[str]


ARRAYS = (
    "vertices",
    "triangles",
    "corner_normals",
    "triangle_object",
    "triangle_material",
    "triangle_polygon",
)


def export_room(objects: Iterable[bpy.types.Object], run: RunFolder, parts: str = "auto") -> Room:
    """Write the objects' triangles to the run folder; objects that carry results are restored first.

    Args:
        objects: those that are no meshes are left out.
        run: the run folder; room.npz and room.json are written.
        parts: where part labels come from: one of `mainjob.PARTS`; the engine resolves "auto".

    Raises:
        FiptError: ``mesh-empty`` where no triangle is left; the run folder's write errors.
    """
    meshes = [item for item in objects if item.type == "MESH"]
    restore_original(meshes)
    room = collect_room(meshes)
    if not len(room.triangles):
        raise FiptError(
            "mesh-empty", "The chosen objects have no faces.", "Choose the mesh objects that form the room."
        )
    with atomic_path(run.room_npz) as temporary:
        np.savez(temporary, **{name: getattr(room, name) for name in ARRAYS})
    write_json(run.room_json, {"objects": room.objects, "materials": room.materials, "parts": parts})
    return room


def read_room(run: RunFolder) -> Room:
    """Read what `export_room` wrote.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    names = read_json(run.room_json)
    try:
        with np.load(run.room_npz, allow_pickle=False) as arrays:
            return Room(
                **{name: arrays[name] for name in ARRAYS},
                objects=list(names["objects"]),
                materials=list(names["materials"]),
            )
    except FileNotFoundError:
        raise FiptError(
            "file-missing", f"{run.room_npz} does not exist.", "Run the step that writes it."
        ) from None
    except (OSError, ValueError, KeyError) as error:
        raise FiptError(
            "file-damaged", f"{run.room_npz} can't be read ({error}).", "Write it again."
        ) from None


def collect_room(objects: Sequence[bpy.types.Object]) -> Room:
    """The triangles of mesh objects in world space, without writing anything."""
    depsgraph = fresh_depsgraph(objects)
    material_ids: dict[str, int] = {}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ARRAYS}
    vertex_count = 0
    for index, item in enumerate(objects):
        evaluated = item.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
        matrix = np.array(item.matrix_world, np.float64)
        loops, polygons = triangle_loops(mesh, mirrored=is_mirrored(item))
        loop_vertex = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", loop_vertex)
        vertices = _vertices(mesh) @ matrix[:3, :3].T + matrix[:3, 3]
        triangles = loop_vertex[loops]
        slots = [material_ids.setdefault(slot.material.name, len(material_ids)) if slot.material else -1
                 for slot in evaluated.material_slots]  # fmt: skip
        slot_index = np.empty(len(mesh.polygons), np.int32)
        mesh.polygons.foreach_get("material_index", slot_index)
        slot_material = np.array(slots or [-1], np.int32)
        parts["vertices"].append(vertices.astype(np.float32))
        parts["triangles"].append(triangles + vertex_count)
        parts["corner_normals"].append(_world_normals(mesh, matrix, loops, vertices[triangles]))
        parts["triangle_object"].append(np.full(len(triangles), index, np.int32))
        parts["triangle_material"].append(
            slot_material[np.clip(slot_index[polygons], 0, len(slot_material) - 1)]
        )
        parts["triangle_polygon"].append(polygons)
        vertex_count += len(vertices)
        evaluated.to_mesh_clear()
    empty = {
        "vertices": np.zeros((0, 3), np.float32),
        "triangles": np.zeros((0, 3), np.int32),
        "corner_normals": np.zeros((0, 3, 3), np.float32),
    }
    arrays = {
        name: np.concatenate([empty.get(name, np.zeros(0, np.int32)), *parts[name]]).astype(
            empty[name].dtype if name in empty else np.int32
        )
        for name in ARRAYS
    }
    return Room(**arrays, objects=[item.name for item in objects], materials=list(material_ids))


def fresh_depsgraph(objects: Iterable[bpy.types.Object]) -> bpy.types.Depsgraph:
    """The dependency graph with the objects' meshes evaluated anew.

    Blender does not notice every change that scripts make to a mesh (removing a UV layer is one).
    """
    for item in objects:
        item.data.update_tag()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return depsgraph


def is_mirrored(item: bpy.types.Object) -> bool:
    """Whether the object's transform turns its triangles inside out (negative determinant)."""
    return item.matrix_world.to_3x3().determinant() < 0.0


def triangle_loops(mesh: bpy.types.Mesh, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
    """A mesh's triangulation in the order of room.npz.

    Args:
        mesh: any mesh.
        mirrored: swap two corners, so that the winding still faces outwards in world space.

    Returns:
        loops (T,3) i32 indices of face corners, polygons (T,) i32.
    """
    mesh.calc_loop_triangles()
    loops = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.loop_triangles.foreach_get("loops", loops)
    polygons = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("polygon_index", polygons)
    loops = loops.reshape(-1, 3)
    return (loops[:, [0, 2, 1]] if mirrored else loops), polygons


def _vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    vertices = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", vertices)
    return vertices.reshape(-1, 3).astype(np.float64)


def _world_normals(
    mesh: bpy.types.Mesh, matrix: np.ndarray, loops: np.ndarray, corners: np.ndarray
) -> np.ndarray:
    """Unit shading normals (T,3,3); where a mesh has none the face's, and up where that is zero too."""
    normals = np.empty(len(mesh.loops) * 3, np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    linear = matrix[:3, :3]
    # The cofactor matrix transforms normals like the inverse transpose, and exists for flat scales too.
    cofactor = np.stack(
        [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    )
    sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
    world = (normals.reshape(-1, 3).astype(np.float64) @ cofactor.T * sign)[loops]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face_length = np.linalg.norm(face, axis=1, keepdims=True)
    face = np.where(face_length > 0.0, face / np.maximum(face_length, 1e-300), [0.0, 0.0, 1.0])
    length = np.linalg.norm(world, axis=2, keepdims=True)
    usable = np.isfinite(length) & (length > 1e-20)
    return np.where(usable, world / np.where(usable, length, 1.0), face[:, None]).astype(np.float32)
