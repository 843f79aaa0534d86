# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas that the engine bakes onto, and the UV layer "FIPT" that carries it on the meshes.

UVs that an artist made are kept where they can hold a texture, else new ones are made; all islands are
then brought to one texel density and packed into few images. The artist's own layers stay untouched.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path, write_json
from ..core.job.settings import Settings
from .own_meshes import make_mesh, room_names
from .packing import (
    island_bounds,
    overlap_share,
    pack_islands,
    place,
    split_sparse_islands,
    triangle_areas,
    turn_islands,
    uv_islands,
)
from .room_export import Room, is_mirrored, read_room, triangle_loops
from .slices import Slices, find_object, run_through

UV_LAYER = "FIPT"
MAX_IMAGES = 16
# Faces that are unwrapped in one go: about 50 ms.
BATCH_CORNERS = 20_000
# What a usable UV map may have of faults, as shares of its object's area.
MAX_OVERLAP = 0.02
MAX_DEGENERATE = 0.05
MAX_COORDINATE = 1.0e3


@dataclass
class Atlas:
    """What `make_atlas` did."""

    images: list[tuple[int, int]]
    kept: list[str]  # objects whose own UVs were good
    unwrapped: list[str]
    texel_density: float  # lowest of all islands, texels a metre


@dataclass
class _Source:
    """What the layout needs of one object; plain arrays, since they outlive a slice."""

    vertices: np.ndarray  # (V,3) world
    loop_vertex: np.ndarray  # (L,)
    loop_start: np.ndarray  # (P,)
    loops: np.ndarray  # (T,3) corners of the triangles
    uv: np.ndarray | None  # (T,3,2) f64 of the artist's active layer


def make_atlas(
    objects: Iterable[bpy.types.Object], run: RunFolder, settings: Settings, max_images: int = MAX_IMAGES
) -> Atlas:
    """Lay the room out for baking: write atlas.npz and atlas.json. The objects are left as they are.

    Args:
        objects: the objects that `export_room` wrote, in any order.
        run: the run folder with its room.
        settings: texel_density, texture_size and atlas_mode count.
        max_images: everything shrinks rather than to make more images.

    Raises:
        FiptError: ``room-changed`` where the objects are not those of the run any more.
    """
    return run_through(atlas_slices(objects, run, settings, max_images))


def atlas_slices(
    objects: Iterable[bpy.types.Object], run: RunFolder, settings: Settings, max_images: int = MAX_IMAGES
) -> Slices[Atlas]:
    """`make_atlas`, a few objects at a time."""
    room = read_room(run)
    if settings.atlas_mode == "color_attribute":
        count = len(room.triangles)
        _write(run, np.zeros((count, 3, 2)), np.full(count, -1), "color_attribute", [])
        return Atlas([], [], [], 0.0)
    names = room_names(room, objects)
    yield
    corner_uv = np.zeros((len(room.triangles), 3, 2))
    island = np.full(len(room.triangles), -1, np.int64)
    areas = triangle_areas(room.vertices[room.triangles])
    kept: list[str] = []
    to_unwrap: list[tuple[str, np.ndarray, _Source]] = []
    for index, name in enumerate(names):
        triangles = np.flatnonzero(room.triangle_object == index)
        source = _read_source(room, index, find_object(name))
        if source.uv is not None and _is_finite(source.uv):
            own_island = uv_islands(room.triangles[triangles], source.uv)
            if uvs_usable(source.uv, own_island, areas[triangles]):
                kept.append(name)
                corner_uv[triangles] = source.uv
                island[triangles] = own_island
                yield
                continue
        to_unwrap.append((name, triangles, source))
        yield
    for batch in _batches(to_unwrap):
        layouts = _unwrap([source for _, _, source in batch])
        for (_, triangles, _), uv in zip(batch, layouts, strict=True):
            corner_uv[triangles] = uv
            island[triangles] = uv_islands(room.triangles[triangles], uv)
        yield
    unwrapped = [name for name, _, _ in to_unwrap]
    sizes, lowest = yield from _pack_room(room, corner_uv, island, areas, run, settings, max_images)
    return Atlas(sizes, kept, unwrapped, lowest)


def _batches(
    items: list[tuple[str, np.ndarray, _Source]],
) -> Iterator[list[tuple[str, np.ndarray, _Source]]]:
    """Objects that are unwrapped in one slice: many small ones, or a large one."""
    batch: list[tuple[str, np.ndarray, _Source]] = []
    corners = 0
    for item in items:
        if batch and corners + len(item[2].loop_vertex) > BATCH_CORNERS:
            yield batch
            batch, corners = [], 0
        batch.append(item)
        corners += len(item[2].loop_vertex)
    if batch:
        yield batch


def _read_source(room: Room, index: int, item: bpy.types.Object) -> _Source:
    mesh = make_mesh(room, index, item)
    try:
        layer, mirrored = mesh.uv_layers.active, is_mirrored(item)
        loops, _ = triangle_loops(mesh, mirrored)
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", vertices)
        loop_vertex = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", loop_vertex)
        loop_start = np.empty(len(mesh.polygons), np.int32)
        mesh.polygons.foreach_get("loop_start", loop_start)
        matrix = np.array(item.matrix_world, np.float64)
        world = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        own = layer is not None and layer.name != UV_LAYER
        return _Source(world, loop_vertex, loop_start, loops, _layer_uv(mesh, layer)[loops] if own else None)
    finally:
        bpy.data.meshes.remove(mesh)


def _pack_room(
    room: Room,
    corner_uv: np.ndarray,
    island: np.ndarray,
    areas: np.ndarray,
    run: RunFolder,
    settings: Settings,
    max_images: int,
) -> Slices[tuple[list[tuple[int, int]], float]]:
    """Bring all islands to one density, pack and write them; image sizes and the lowest density.

    Args:
        corner_uv: (T,3,2), overwritten with the result.
        island: (T,), numbered within each object.
        areas: (T,) in the world.
    """
    # Islands were numbered within their object; now over the room.
    many = int(island.max(initial=0)) + 1
    _, island = np.unique(room.triangle_object.astype(np.int64) * many + island, return_inverse=True)
    island_count = int(island.max(initial=-1)) + 1

    # Islands without area in space or in the plane can't hold texels.
    world_area = np.bincount(island, areas, island_count)
    flat_area = np.bincount(island, triangle_areas(corner_uv), island_count)
    holds = (world_area > 1e-12) & (flat_area > 1e-14)
    chosen = holds[island]
    density = settings.texel_density * _island_scale(room.triangle_object, island, world_area, flat_area)
    texels = corner_uv[chosen] * density[island[chosen]][:, None, None]
    owner = room.triangle_object[chosen].astype(np.int64)
    polygon = room.triangle_polygon[chosen]
    member = np.zeros(len(texels), np.int64)
    count = 0
    for each in np.unique(owner):
        mine = np.flatnonzero(owner == each)
        own = np.unique(island[chosen][mine], return_inverse=True)[1]
        turned = turn_islands(texels[mine], own)
        own = split_sparse_islands(turned, own, polygon[mine])
        texels[mine] = turn_islands(turned, own)
        member[mine] = own + count
        count += int(own.max()) + 1
        yield
    low, extent = island_bounds(texels, member)
    group = np.zeros(len(low), np.int64)
    group[member] = owner
    packing = pack_islands(extent, group, settings.texture_size, max_images=max_images)
    placed = place(texels, member, low, packing)

    image = np.full(len(room.triangles), -1, np.int64)
    image[chosen] = packing.image[member]
    sizes = np.array(packing.sizes, np.float64).reshape(-1, 2)
    corner_uv[:] = 0.0
    corner_uv[chosen] = placed / sizes[image[chosen]][:, None]
    _write(run, corner_uv, image, "uv", packing.sizes)
    if not len(packing.scale):
        raise FiptError(
            "mesh-empty", "The room's faces have no area.", "Choose the mesh objects that form the room."
        )
    yield
    return packing.sizes, settings.texel_density * float(packing.scale.min(initial=1.0))


def _island_scale(
    triangle_object: np.ndarray, island: np.ndarray, world_area: np.ndarray, flat_area: np.ndarray
) -> np.ndarray:
    """Metres a UV unit of each island, (N,) f64.

    At most twice that of its object: an island that is seen edge on in its map would else fill an image.
    """
    owner = np.zeros(len(world_area), np.int64)
    owner[island] = triangle_object
    whole = np.bincount(owner, world_area) / np.maximum(np.bincount(owner, flat_area), 1e-30)
    single = world_area / np.maximum(flat_area, 1e-30)
    return np.sqrt(np.minimum(single, 4.0 * whole[owner]))


def _is_finite(uv: np.ndarray) -> bool:
    return bool(np.isfinite(uv).all()) and float(np.abs(uv).max(initial=0.0)) <= MAX_COORDINATE


def uvs_usable(corner_uv: np.ndarray, island: np.ndarray, area: np.ndarray) -> bool:
    """Whether UVs can hold one texture without a surface point sharing its texel with another.

    Islands that lie on each other are fine, since each is packed anew; an island that lies on itself is
    not, nor are faces that the map squeezes to nothing.

    Args:
        corner_uv: (T,3,2) of one object.
        island: (T,) of `uv_islands`.
        area: (T,) in the world, m².
    """
    flat = triangle_areas(corner_uv)
    if not len(flat) or flat.sum() <= 0.0 or area.sum() <= 0.0:
        return False
    # A face squeezed to less than a hundredth of its share of the map is degenerate.
    expected = area * (flat.sum() / area.sum())
    if area[flat < 1e-4 * expected].sum() > MAX_DEGENERATE * area.sum():
        return False
    return overlap_share(corner_uv, island) <= MAX_OVERLAP


def _layer_uv(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """(L,2) f64."""
    uv = np.empty(len(mesh.loops) * 2, np.float32)
    layer.uv.foreach_get("vector", uv)
    return uv.reshape(-1, 2).astype(np.float64)


def _unwrap(sources: Sequence[_Source]) -> list[np.ndarray]:
    """Unwrap by projection from several sides (Smart UV Project).

    The operator runs once, on copies in a scene of their own, so that neither selection, mode nor
    visibility of the artist's scene matter.

    Returns:
        For each object (T,3,2) f64 by triangle corner.
    """
    scene = bpy.data.scenes.new("FIPT unwrap")
    layer = scene.view_layers[0]
    copies = [_blank_copy(source) for source in sources]
    stand_ins = [bpy.data.objects.new("FIPT unwrap", copy) for copy in copies]
    try:
        for stand_in in stand_ins:
            scene.collection.objects.link(stand_in)
            stand_in.select_set(True, view_layer=layer)
        first = stand_ins[0]
        layer.objects.active = first
        with bpy.context.temp_override(
            scene=scene, view_layer=layer, active_object=first, object=first, selected_objects=stand_ins
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            try:
                with bpy.context.temp_override(edit_object=first):
                    bpy.ops.mesh.select_all(action="SELECT")
                    bpy.ops.uv.smart_project(island_margin=0.0, area_weight=0.0, scale_to_bounds=False)
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
        return [
            _layer_uv(copy, copy.uv_layers[UV_LAYER])[source.loops]
            for copy, source in zip(copies, sources, strict=True)
        ]
    finally:
        bpy.data.batch_remove([*stand_ins, *copies])
        bpy.data.scenes.remove(scene)


def _blank_copy(source: _Source) -> bpy.types.Mesh:
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


def write_layer(mesh: bpy.types.Mesh, mirrored: bool, corner_uv: np.ndarray) -> None:
    """Write the FIPT layer of a mesh of ours, and make it the active one, which solid shading draws with.

    The layer that renders use where a material names none stays the artist's.

    Args:
        mesh: of ours.
        mirrored: whether its object is.
        corner_uv: (T,3,2), the object's rows of atlas.npz.

    Raises:
        FiptError: ``uv-layers-full``.
    """
    active_render = [layer.active_render for layer in mesh.uv_layers]
    layer = mesh.uv_layers.get(UV_LAYER) or mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    if layer is None:
        raise FiptError(
            "uv-layers-full",
            f"The mesh of '{mesh.name}' has 8 UV layers already; ours does not fit.",
            "Remove a UV layer, or choose colour attributes instead of UVs.",
        )
    loops, _ = triangle_loops(mesh, mirrored)
    uv = np.zeros((len(mesh.loops), 2), np.float32)
    uv[loops.ravel()] = corner_uv.reshape(-1, 2)
    mesh.uv_layers[UV_LAYER].uv.foreach_set("vector", uv.ravel())
    mesh.uv_layers.active = mesh.uv_layers[UV_LAYER]
    if True in active_render:
        mesh.uv_layers[active_render.index(True)].active_render = True


def _write(
    run: RunFolder, corner_uv: np.ndarray, image: np.ndarray, mode: str, sizes: list[tuple[int, int]]
) -> None:
    with atomic_path(run.atlas_npz) as temporary:
        np.savez(temporary, corner_uv=corner_uv.astype(np.float32), triangle_image=image.astype(np.int32))
    images = [
        {"name": f"Room.{index:03d}", "width": width, "height": height}
        for index, (width, height) in enumerate(sizes, start=1)
    ]
    write_json(run.atlas_json, {"mode": mode, "images": images})
