"""UVs of single objects: the artist's where they can hold a texture, else new ones by Smart UV Project."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.run.run_files import RoomMesh
from ...core.textures.raster import cover_count
from .islands import island_bounds, triangle_areas
from .mesh_arrays import (
    corner_uvs,
    corner_vertices,
    is_mirrored,
    polygon_starts,
    transform_points,
    triangle_loops,
    vertex_positions,
)
from .packing import pack_islands, place
from .result_meshes import make_mesh
from .uv_layer import UV_LAYER

# A mesh of at least so many triangles whose area is spread evenly over them is a scan: the mean area of a
# triangle, weighted by area, over the plain mean is about 2 for marching cubes, and hundreds for modelled
# rooms, whose walls are a few triangles.
LEAST_TRIANGLES = 20_000
MOST_UNEVEN = 50.0
# Rounds of Blender's modifier Smooth before a scan is unwrapped. Noise of a quarter of an edge else tears
# a room of 206,000 triangles into 19,000 islands; with 10 rounds it has 150.
SMOOTH_ROUNDS = 10


@dataclass(frozen=True)
class UnwrapSource:
    """What unwrapping needs of one object, in plain arrays, since they outlive a slice."""

    vertices: np.ndarray  # (V,3) world
    loop_vertex: np.ndarray  # (L,) vertex of each face corner
    loop_start: np.ndarray  # (P,) first face corner of each polygon
    loops: np.ndarray  # (T,3) face corners of the triangles
    uv: np.ndarray | None  # (T,3,2) f64 of the artist's active layer


def read_source(room: RoomMesh, index: int, item: bpy.types.Object) -> UnwrapSource:
    """Read an object of the room."""
    mesh, _ = make_mesh(room, index, item)
    try:
        layer = mesh.uv_layers.active
        loops, _ = triangle_loops(mesh, is_mirrored(item))
        vertices = transform_points(vertex_positions(mesh), np.array(item.matrix_world, np.float64))
        of_artist = layer is not None and layer.name != UV_LAYER
        uv = corner_uvs(mesh, layer)[loops] if of_artist else None
        return UnwrapSource(vertices, corner_vertices(mesh), polygon_starts(mesh), loops, uv)
    finally:
        bpy.data.meshes.remove(mesh)


def exported_source(room: RoomMesh, index: int) -> UnwrapSource:
    """An object of the room that is missing in the scene, as it was exported; its polygons are triangles."""
    vertices, inverse = np.unique(room.triangles[room.triangle_object == index], return_inverse=True)
    corners = np.arange(inverse.size, dtype=np.int32)
    positions = room.vertices[vertices].astype(np.float64)
    return UnwrapSource(
        positions, inverse.ravel().astype(np.int32), corners[::3], corners.reshape(-1, 3), None
    )


def is_scan(areas: np.ndarray) -> bool:
    """Whether a mesh with triangles of these areas (T,) looks like a scan: many, and evenly sized."""
    total = float(areas.sum())
    if len(areas) < LEAST_TRIANGLES or total <= 0.0:
        return False
    return float((areas * areas).sum()) * len(areas) < MOST_UNEVEN * total * total


def uvs_in_range(corner_uv: np.ndarray) -> bool:
    """Whether all UVs (T,3,2) are finite and not absurdly large."""
    return bool(np.isfinite(corner_uv).all()) and float(np.abs(corner_uv).max(initial=0.0)) <= 1.0e3


def uvs_usable(corner_uv: np.ndarray, island: np.ndarray, area: np.ndarray) -> bool:
    """Whether UVs can hold one texture without two surface points sharing a texel.

    Islands may overlap each other, since they are packed again. An island may not overlap itself, and faces
    may not be squeezed to nothing.

    Args:
        corner_uv: (T,3,2) of one object.
        island: (T,) of `uv_islands`.
        area: (T,) in the world, m².
    """
    flat = triangle_areas(corner_uv)
    if not len(flat) or flat.sum() <= 0.0 or area.sum() <= 0.0:
        return False
    # A face is degenerate below a ten-thousandth of its share of the map's area.
    expected = area * (flat.sum() / area.sum())
    if area[flat < 1e-4 * expected].sum() > 0.05 * area.sum():
        return False
    return overlap_share(corner_uv, island) <= 0.02


def overlap_share(corner_uv: np.ndarray, island: np.ndarray) -> float:
    """Share of the covered texels that more than one triangle of the same island covers, 0 to 1.

    The islands are packed apart first, since only an island that overlaps itself is unusable.

    Args:
        corner_uv: (T,3,2) of one object.
        island: (T,) of `uv_islands`.
    """
    texels = 40_000  # to which the islands are scaled for the test
    low, extent = island_bounds(corner_uv, island)
    total = float((extent[:, 0] * extent[:, 1]).sum())
    if not np.isfinite(total) or total <= 0.0:
        return 1.0
    side = max(int(math.sqrt(texels * 2.0)), 64)
    packing = pack_islands(extent * math.sqrt(texels / total), np.zeros(len(extent), np.int32), side, 1, 64)
    shared = covered = 0
    placed = place(corner_uv, island, low, packing, math.sqrt(texels / total))
    for image, (width, height) in enumerate(packing.sizes):
        count = cover_count(placed[packing.image[island] == image], width, height)
        shared += int((count > 1).sum())
        covered += int((count > 0).sum())
    return shared / covered if covered else 1.0


def unwrap(sources: Sequence[UnwrapSource], scans: Sequence[bool]) -> list[np.ndarray]:
    """Unwrap objects by projection from several sides (Smart UV Project).

    The operator runs once, on copies in a scene of their own, so that selection, mode and visibility in the
    artist's scene don't matter.

    Args:
        sources: of the objects.
        scans: which of them are scans, of which a smoothed copy is unwrapped.

    Returns:
        For each object (T,3,2) f64 by triangle corner.
    """
    scene = bpy.data.scenes.new("FIPT unwrap")
    layer = scene.view_layers[0]
    meshes = [_blank_mesh(source) for source in sources]
    objects = [bpy.data.objects.new("FIPT unwrap", mesh) for mesh in meshes]
    try:
        for item in objects:
            scene.collection.objects.link(item)
            item.select_set(True, view_layer=layer)
        for number in np.flatnonzero(scans).tolist():
            meshes.append(_smoothed(objects[number], layer))
        first = objects[0]
        layer.objects.active = first
        with bpy.context.temp_override(
            scene=scene, view_layer=layer, active_object=first, object=first, selected_objects=objects
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            try:
                with bpy.context.temp_override(edit_object=first):
                    bpy.ops.mesh.select_all(action="SELECT")
                    bpy.ops.uv.smart_project(island_margin=0.0, area_weight=0.0, scale_to_bounds=False)
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
        return [
            corner_uvs(item.data, item.data.uv_layers[UV_LAYER])[source.loops]
            for item, source in zip(objects, sources, strict=True)
        ]
    finally:
        bpy.data.batch_remove([*objects, *meshes])
        bpy.data.scenes.remove(scene)


def _smoothed(item: bpy.types.Object, layer: bpy.types.ViewLayer) -> bpy.types.Mesh:
    """Give an object a smoothed copy of its mesh, which is returned."""
    modifier = item.modifiers.new("Smooth", "SMOOTH")
    modifier.factor, modifier.iterations = 0.5, SMOOTH_ROUNDS
    layer.update()
    item.data = bpy.data.meshes.new_from_object(item.evaluated_get(layer.depsgraph))
    item.modifiers.clear()
    return item.data


def _blank_mesh(source: UnwrapSource) -> bpy.types.Mesh:
    """The faces in world space, so that stretched objects are unwrapped as they look, and an empty layer."""
    mesh = bpy.data.meshes.new("FIPT unwrap")
    mesh.vertices.add(len(source.vertices))
    mesh.loops.add(len(source.loop_vertex))
    mesh.polygons.add(len(source.loop_start))
    mesh.vertices.foreach_set("co", source.vertices.astype(np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", source.loop_vertex)
    mesh.polygons.foreach_set("loop_start", source.loop_start)
    mesh.update(calc_edges=True)
    mesh.uv_layers.new(name=UV_LAYER)
    return mesh
