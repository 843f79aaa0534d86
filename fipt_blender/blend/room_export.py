# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's objects to room.npz and room.json: one triangle soup in world space with ids.

The meshes are the evaluated ones, modifiers included. docs/architecture.md describes the arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path, read_json, write_json
from .originals import show_original, shows_original
from .slices import Slices, find_object, run_through


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


_CHUNK = 1 << 15
ARRAYS = (
    "vertices",
    "triangles",
    "corner_normals",
    "triangle_object",
    "triangle_material",
    "triangle_polygon",
)


def export_room(objects: Iterable[bpy.types.Object], run: RunFolder, parts: str = "auto") -> Room:
    """Write the objects' triangles to the run folder; of objects that carry results, the artist's mesh.

    Args:
        objects: those that are no meshes are left out.
        run: the run folder; room.npz and room.json are written.
        parts: where part labels come from: one of `mainjob.PARTS`; the engine resolves "auto".

    Raises:
        FiptError: ``mesh-empty`` where no triangle is left; the run folder's write errors.
    """
    return run_through(export_slices(objects, run, parts))


def export_slices(objects: Iterable[bpy.types.Object], run: RunFolder, parts: str = "auto") -> Slices[Room]:
    """`export_room` in slices.

    Raises:
        FiptError: further ``room-changed`` and ``room-edited`` where the artist works on the room meanwhile.
    """
    room = yield from collect_slices(objects)
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


def collect_room(objects: Iterable[bpy.types.Object]) -> Room:
    """The triangles of mesh objects in world space, without writing anything."""
    return run_through(collect_slices(objects))


def collect_slices(objects: Iterable[bpy.types.Object]) -> Slices[Room]:
    """`collect_room` in slices.

    Raises:
        FiptError: ``room-changed`` or ``room-edited`` where the artist works on the room meanwhile.
    """
    # Their names: between two slices an undo may replace every object.
    names = [item.name for item in objects if item.type == "MESH"]
    # All at once: each change makes the viewport draw anew.
    fresh_depsgraph([bpy.data.objects[name] for name in names])
    yield
    material_ids: dict[str, int] = {}
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ARRAYS}
    vertex_count = 0
    for index, name in enumerate(names):
        arrays = yield from _object_slices(name, material_ids)
        arrays["triangles"] += vertex_count
        arrays["triangle_object"] = np.full(len(arrays["triangles"]), index, np.int32)
        vertex_count += len(arrays["vertices"])
        for key, values in arrays.items():
            parts[key].append(values)
    empty = {
        "vertices": np.zeros((0, 3), np.float32),
        "triangles": np.zeros((0, 3), np.int32),
        "corner_normals": np.zeros((0, 3, 3), np.float32),
    }
    joined = {key: np.concatenate([empty.get(key, np.zeros(0, np.int32)), *parts[key]]) for key in ARRAYS}
    return Room(**joined, objects=names, materials=list(material_ids))


def _object_slices(name: str, material_ids: dict[str, int]) -> Slices[dict[str, np.ndarray]]:
    """The arrays of one object but `triangle_object`; triangles count its own vertices.

    Args:
        name: of the object.
        material_ids: number of each material by name; new ones are added.
    """
    raw = _Raw(material_ids)
    with _evaluated(name) as (item, mesh):
        counts = _counts(mesh)
        raw.read_normals(item, mesh)
        if small := len(mesh.loops) < _CHUNK:
            raw.read_triangles(mesh)
            raw.read_vertices(mesh)
    if not small:
        yield
        with _evaluated(name, counts) as (_, mesh):
            raw.read_triangles(mesh)
        yield
        with _evaluated(name, counts) as (_, mesh):
            raw.read_vertices(mesh)
    loops, polygons, vertices, matrix = raw.loops, raw.polygons, raw.vertices, raw.matrix
    triangles = raw.loop_vertex[loops]
    slot_material = np.array(raw.slots or [-1], np.int32)
    world_normals = []
    for start in range(0, len(loops), _CHUNK):
        yield
        part = slice(start, start + _CHUNK)
        world_normals.append(_world_normals(raw.normals, matrix, loops[part], vertices[triangles[part]]))
    return {
        "vertices": vertices.astype(np.float32),
        "triangles": triangles,
        "corner_normals": np.concatenate([np.zeros((0, 3, 3), np.float32), *world_normals]),
        "triangle_material": slot_material[np.clip(raw.slot_index[polygons], 0, len(slot_material) - 1)],
        "triangle_polygon": polygons,
    }


class _Raw:
    """What is read of one object, in parts that each take less than a frame may wait."""

    def __init__(self, material_ids: dict[str, int]) -> None:
        self._material_ids = material_ids

    def read_normals(self, item: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
        self.matrix, self.mirrored = np.array(item.matrix_world, np.float64), is_mirrored(item)
        names = [slot.material.name if slot.material else "" for slot in item.material_slots]
        ids = self._material_ids
        self.slots = [ids.setdefault(name, len(ids)) if name else -1 for name in names]
        self.normals = _corner_normals(mesh)

    def read_triangles(self, mesh: bpy.types.Mesh) -> None:
        self.loops, self.polygons = triangle_loops(mesh, self.mirrored)

    def read_vertices(self, mesh: bpy.types.Mesh) -> None:
        self.vertices = _vertices(mesh) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        self.loop_vertex = _corner_vertices(mesh)
        self.slot_index = _polygon_slots(mesh)


@contextmanager
def _evaluated(
    name: str, counts: tuple[int, ...] | None = None
) -> Iterator[tuple[bpy.types.Object, bpy.types.Mesh]]:
    """An object, evaluated without results of ours, and a mesh of it for the length of the block.

    Args:
        name: of the object.
        counts: of the mesh in an earlier slice.

    Raises:
        FiptError: ``room-changed`` where the mesh is another one than then; ``room-edited``.
    """
    item = find_object(name)
    ours_shown = not shows_original(item)
    show_original(item, True)
    try:
        evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        if counts not in (None, _counts(mesh)):
            raise FiptError(
                "room-changed",
                f"'{name}' was changed while it was prepared for the engine.",
                "Start again, and leave the room as it is for these seconds.",
            )
        yield evaluated, mesh
        evaluated.to_mesh_clear()
    finally:
        if ours_shown:
            show_original(item, False)


def _counts(mesh: bpy.types.Mesh) -> tuple[int, ...]:
    return len(mesh.vertices), len(mesh.loops), len(mesh.polygons)


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
    mesh.loop_triangle_polygons.foreach_get("value", polygons)
    loops = loops.reshape(-1, 3)
    return (loops[:, [0, 2, 1]] if mirrored else loops), polygons


def _vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    vertices = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", vertices)
    return vertices.reshape(-1, 3).astype(np.float64)


def _corner_vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    vertices = np.empty(len(mesh.loops), np.int32)
    if len(vertices):  # ten times as fast as asking each of `mesh.loops`
        mesh.attributes[".corner_vert"].data.foreach_get("value", vertices)
    return vertices


def _corner_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    normals = np.empty(len(mesh.loops) * 3, np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    return normals.reshape(-1, 3)


def _polygon_slots(mesh: bpy.types.Mesh) -> np.ndarray:
    index = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", index)
    return index


def _world_normals(
    normals: np.ndarray, matrix: np.ndarray, loops: np.ndarray, corners: np.ndarray
) -> np.ndarray:
    """Unit shading normals (T,3,3); where a mesh has none the face's, and up where that is zero too.

    Args:
        normals: (L,3) of the mesh's face corners, in its own space.
        matrix: its world matrix.
        loops: (T,3) corners of the wanted triangles.
        corners: (T,3,3) their positions in the world.
    """
    linear = matrix[:3, :3]
    # The cofactor matrix transforms normals like the inverse transpose, and exists for flat scales too.
    cofactor = np.stack(
        [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    )
    sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
    world = normals[loops].astype(np.float64) @ cofactor.T * sign
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face_length = np.linalg.norm(face, axis=1, keepdims=True)
    face = np.where(face_length > 0.0, face / np.maximum(face_length, 1e-300), [0.0, 0.0, 1.0])
    length = np.linalg.norm(world, axis=2, keepdims=True)
    usable = np.isfinite(length) & (length > 1e-20)
    return np.where(usable, world / np.where(usable, length, 1.0), face[:, None]).astype(np.float32)
