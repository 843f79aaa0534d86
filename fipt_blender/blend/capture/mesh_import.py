"""Imports the room's mesh file into the scene, in the capture's world coordinates.

Blender's importers read the file. None of them may convert the axes, since the capture's `world_from_source`
does that for cameras and mesh alike.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core import conventions
from ...core.capture.mesh_file import read_mesh
from ...core.run.errors import FiptError
from ...core.run.shapes import FARTHEST
from ..image_datablocks import check_length
from ..outliner import ROOM, collection, move_to
from ..room.mesh_arrays import corner_normals, corner_vertices
from .mesh_names import check_mesh_file

_AS_STORED = {"forward_axis": "Y", "up_axis": "Z"}
# suffix -> (operator module, operator, arguments); the first operator that exists is used.
IMPORTERS: dict[str, list[tuple[str, str, dict[str, Any]]]] = {
    ".obj": [("wm", "obj_import", {**_AS_STORED, "validate_meshes": True})],
    ".ply": [("wm", "ply_import", _AS_STORED)],
    ".stl": [("wm", "stl_import", _AS_STORED)],
    ".gltf": [("import_scene", "gltf", {})],
    ".glb": [("import_scene", "gltf", {})],
    ".fbx": [("wm", "fbx_import", {}), ("import_scene", "fbx", {})],
    ".usd": [("wm", "usd_import", {})],
    ".usdc": [("wm", "usd_import", {})],
    ".usda": [("wm", "usd_import", {})],
    ".usdz": [("wm", "usd_import", {})],
}
# What importers may change of a scene, its render settings and its units.
_KEPT = (
    ("frame_start", "frame_end", "frame_step", "frame_current", "use_preview_range", "camera", "world"),
    ("fps", "fps_base"),
    ("system", "scale_length", "length_unit"),
)
# What importers have converted from Y up to Z up is turned back: glTF always, USD by its own up axis.
_UNDO = np.linalg.inv(conventions.world_from_source("y"))


def import_room(
    path: str | Path, world_from_source: np.ndarray, scene: bpy.types.Scene | None = None
) -> list[str]:
    """Import a mesh file into the collection of the room's parts.

    Transforms are applied to the mesh data, so that every object's matrix is the identity. FBX files state
    their own axes: Blender's importer converts them before `world_from_source` is applied.

    Args:
        path: OBJ, PLY, STL, glTF, FBX or USD file.
        world_from_source: 4x4, the file's coordinates to Blender's world.
        scene: the collection's scene; the context's by default.

    Returns:
        Names of the mesh objects, in the order of the file.
    """
    path = Path(path)
    if not path.is_file():
        raise FiptError("mesh-missing.import-room-2", path=path)
    if path.suffix.lower() == ".ply":  # its importer crashes at damaged files
        read_mesh(path)
    return import_meshes(path, world_from_source, scene)


def import_meshes(
    path: Path, world_from_source: np.ndarray, scene: bpy.types.Scene | None = None
) -> list[str]:
    """`import_room` of a file at which the importer may crash."""
    check_length(path)
    check_mesh_file(path)
    existing = {item.as_pointer() for item in bpy.data.objects}
    with _selection_kept(), _scene_kept():
        _run_importer(path)
    new = [item for item in bpy.data.objects if item.as_pointer() not in existing]
    for item in new:
        _put_at_rest(item)
    bpy.context.view_layer.update()
    matrices = {item.name: np.array(item.matrix_world, np.float64) for item in new}
    target = collection(scene or bpy.context.scene, ROOM)
    similarity = np.asarray(world_from_source, np.float64) @ (_UNDO if _is_y_up(path) else np.eye(4))
    meshes = [item for item in new if item.type == "MESH" and len(item.data.polygons)]
    for item in meshes:
        if item.data.users > 1:
            item.data = item.data.copy()
        item.parent = None
        transform_mesh(item.data, similarity @ matrices[item.name])
        mark_turned_edges(item.data)
        item.matrix_world = Matrix.Identity(4)
        move_to(item, target)
    count = sum(len(item.data.vertices) for item in meshes)
    wrong = sum(_wrong_vertices(item.data) for item in meshes)
    for item in [other for other in new if wrong or other not in meshes]:
        bpy.data.objects.remove(item)
    if wrong:
        raise FiptError("mesh-not-finite", wrong=wrong, count=count, path=path, farthest=FARTHEST)
    names = [item.name for item in meshes]
    if not names:
        raise FiptError("mesh-empty.import-meshes", path=path)
    return names


def _is_y_up(path: Path) -> bool:
    """Whether Blender's importer has turned a file from Y up to Z up."""
    suffix = path.suffix.lower()
    if not suffix.startswith(".usd"):
        return suffix in (".gltf", ".glb")
    try:
        from pxr import Usd, UsdGeom
    except ImportError:  # of Blender as a module: only text says it; without a word Y is up
        with path.open("rb") as file:
            return re.search(rb'upAxis\s*=\s*"Z"', file.read(1 << 16)) is None
    return str(UsdGeom.GetStageUpAxis(Usd.Stage.Open(str(path)))) == "Y"


def _wrong_vertices(mesh: bpy.types.Mesh) -> int:
    """Number of vertices that are not finite, or farther away than any room."""
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    return int((~(np.abs(positions.reshape(-1, 3)) <= FARTHEST)).any(axis=1).sum())


@contextmanager
def _selection_kept() -> Iterator[None]:
    """Restore the artist's selection afterwards: importers select what they import."""
    layer = bpy.context.view_layer
    active = layer.objects.active.name if layer.objects.active else ""
    selected = {item.name for item in layer.objects.selected}
    try:
        yield
    finally:
        for item in layer.objects:
            item.select_set(item.name in selected)
        layer.objects.active = layer.objects.get(active)


@contextmanager
def _scene_kept() -> Iterator[None]:
    """Restore what importers change of the scene: its frames, rate, unit, camera and world."""
    scene, worlds = bpy.context.scene, set(bpy.data.worlds)
    owners = scene, scene.render, scene.unit_settings
    kept = [
        {name: getattr(owner, name) for name in names} for owner, names in zip(owners, _KEPT, strict=True)
    ]
    scene.world = None  # else the importer of USD changes its nodes
    try:
        yield
    finally:
        for owner, values in zip(owners, kept, strict=True):
            for name, value in values.items():
                if getattr(owner, name) != value:
                    setattr(owner, name, value)
        for world in set(bpy.data.worlds) - worlds:
            if not world.users:
                bpy.data.worlds.remove(world)


def _put_at_rest(item: bpy.types.Object) -> None:
    """Take an imported object's animation away: a room has the shape that its file stores."""
    item.animation_data_clear()
    if item.type == "ARMATURE":
        item.data.pose_position = "REST"
    item.constraints.clear()
    if item.type == "MESH":
        if item.data.shape_keys is not None:
            item.shape_key_clear()
        item.modifiers.clear()


def _run_importer(path: Path) -> None:
    suffix = path.suffix.lower()
    for module, name, arguments in IMPORTERS.get(suffix, []):
        operator = getattr(getattr(bpy.ops, module), name)
        try:
            operator.get_rna_type()
        except KeyError:
            continue
        try:
            result = operator(filepath=str(path), **arguments)
        except RuntimeError as error:
            raise _unreadable(path, str(error).strip()) from None
        if "FINISHED" not in result:
            raise _unreadable(path, "Blender's importer failed")
        return
    raise FiptError("mesh-format", suffix=suffix or "nameless", path=path)


def _unreadable(path: Path, reason: str) -> FiptError:
    return FiptError("mesh-unreadable.unreadable", path=path, reason=reason)


def mark_turned_edges(mesh: bpy.types.Mesh) -> None:
    """Mark the edges between faces of opposite winding as sharp.

    Blender shades them as sharp in any case, so no normal changes. Cycles splits a mesh at marked edges only:
    without the mark one of the two faces would get the other's normals and render black.
    """
    edge_of, vertex_of = np.empty(len(mesh.loops), np.int32), corner_vertices(mesh)
    mesh.loops.foreach_get("edge_index", edge_of)
    ends = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", ends)
    forward = ends[2 * edge_of] == vertex_of
    uses = np.bincount(edge_of, minlength=len(mesh.edges))
    forwards = np.bincount(edge_of, forward, minlength=len(mesh.edges))
    turned = (forwards > 1) | (uses - forwards > 1)
    if not turned.any():
        return
    attribute = mesh.attributes.get("sharp_edge") or mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    sharp = np.empty(len(mesh.edges), bool)
    attribute.data.foreach_get("value", sharp)
    attribute.data.foreach_set("value", sharp | turned)
    mesh.update()


def transform_mesh(mesh: bpy.types.Mesh, matrix: np.ndarray) -> None:
    """Apply a 4x4 matrix to a mesh with its shading normals; mirrored faces still face outwards."""
    linear = matrix[:3, :3]
    mirrored = float(np.linalg.det(linear)) < 0.0
    custom = mesh.has_custom_normals
    if custom:
        order, normals = ordered_normals(mesh)
        normals = normals @ np.linalg.inv(linear)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    mesh.transform(Matrix(matrix.tolist()))
    if mirrored:
        mesh.flip_normals()
    if custom:
        order, _ = ordered_normals(mesh)
        restored = np.empty_like(normals)
        restored[order] = normals
        mesh.normals_split_custom_set(restored.astype(np.float32).tolist())
    mesh.update()


def ordered_normals(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Face corners sorted by polygon and vertex, an order that flipping keeps, and their normals (f64)."""
    total = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", total)
    polygon = np.repeat(np.arange(len(total)), total)
    order = np.lexsort((corner_vertices(mesh), polygon))
    return order, corner_normals(mesh).astype(np.float64)[order]
