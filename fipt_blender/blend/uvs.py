# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas that the engine bakes onto, and the UV layer "FIPT" that carries it on the meshes.

UVs that an artist made are kept where they can hold a texture, else new ones are made; all islands are
then brought to one texel density and packed into few images. The artist's own layers stay untouched.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path, write_json
from ..core.job.settings import Settings
from .originals import make_own_mesh, restore_original
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
from .room_export import Room, fresh_depsgraph, is_mirrored, read_room, triangle_loops

UV_LAYER = "FIPT"
MAX_IMAGES = 16
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
    room = read_room(run)
    if settings.atlas_mode == "color_attribute":
        count = len(room.triangles)
        _write(run, np.zeros((count, 3, 2)), np.full(count, -1), "color_attribute", [])
        return Atlas([], [], [], 0.0)
    ordered = own_meshes(room, objects)
    try:
        return _make_uv_atlas(ordered, room, run, settings, max_images)
    finally:
        restore_original(ordered)


def own_meshes(room: Room, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Give the room's objects meshes that are ours to write, and check that they are those of the run.

    Returns:
        The objects in the room's order.

    Raises:
        FiptError: ``room-changed``; the objects are then as before.
    """
    by_name = {item.name: item for item in objects if item.type == "MESH"}
    for name in room.objects:
        if name not in by_name:
            raise _room_changed(name)
    ordered = [by_name[name] for name in room.objects]
    restore_original(ordered)
    depsgraph = fresh_depsgraph(ordered)
    for index, item in enumerate(ordered):
        make_own_mesh(item, depsgraph)
        _, polygons = triangle_loops(item.data, is_mirrored(item))
        if not np.array_equal(polygons, room.triangle_polygon[room.triangle_object == index]):
            restore_original(ordered)
            raise _room_changed(item.name)
    return ordered


def _room_changed(name: str) -> FiptError:
    return FiptError(
        "room-changed",
        f"The object '{name}' was changed, renamed or removed since the room was exported.",
        "Undo the change, or start a new run.",
    )


def _make_uv_atlas(
    objects: list[bpy.types.Object], room: Room, run: RunFolder, settings: Settings, max_images: int
) -> Atlas:
    corner_uv = np.zeros((len(room.triangles), 3, 2))
    island = np.full(len(room.triangles), -1, np.int64)
    areas = triangle_areas(room.vertices[room.triangles])
    kept: list[str] = []
    to_unwrap: list[int] = []
    for index, item in enumerate(objects):
        triangles = np.flatnonzero(room.triangle_object == index)
        uv = active_corner_uv(item)
        if uv is not None and _is_finite(uv):
            own_island = uv_islands(room.triangles[triangles], uv)
            if uvs_usable(uv, own_island, areas[triangles]):
                kept.append(item.name)
                corner_uv[triangles] = uv
                island[triangles] = own_island
                continue
        to_unwrap.append(index)
    for index, uv in zip(to_unwrap, unwrap([objects[index] for index in to_unwrap]), strict=True):
        triangles = np.flatnonzero(room.triangle_object == index)
        corner_uv[triangles] = uv
        island[triangles] = uv_islands(room.triangles[triangles], uv)
    unwrapped = [objects[index].name for index in to_unwrap]
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
    texels = turn_islands(corner_uv[chosen] * density[island[chosen]][:, None, None], island[chosen])
    owner = room.triangle_object[chosen].astype(np.int64)
    polygon = owner * (int(room.triangle_polygon.max(initial=0)) + 1) + room.triangle_polygon[chosen]
    member = split_sparse_islands(texels, np.unique(island[chosen], return_inverse=True)[1], polygon)
    texels = turn_islands(texels, member)
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
    lowest = settings.texel_density * float(packing.scale.min(initial=1.0))
    return Atlas(packing.sizes, kept, unwrapped, lowest)


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


def active_corner_uv(item: bpy.types.Object) -> np.ndarray | None:
    """The artist's active UV layer by triangle corner, (T,3,2) f64, or None without one."""
    layer = item.data.uv_layers.active
    if layer is None or layer.name == UV_LAYER:
        return None
    return _corner_uv(item.data, layer, is_mirrored(item))


def _corner_uv(mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer, mirrored: bool) -> np.ndarray:
    uv = np.empty(len(mesh.loops) * 2, np.float32)
    layer.uv.foreach_get("vector", uv)
    loops, _ = triangle_loops(mesh, mirrored)
    return uv.reshape(-1, 2).astype(np.float64)[loops]


def unwrap(items: Sequence[bpy.types.Object]) -> list[np.ndarray]:
    """Unwrap by projection from several sides (Smart UV Project) without touching the objects.

    The operator runs once, on copies in a scene of their own, so that neither selection, mode nor
    visibility of the artist's scene matter.

    Returns:
        For each object (T,3,2) f64 by triangle corner.
    """
    if not items:
        return []
    scene = bpy.data.scenes.new("FIPT unwrap")
    layer = scene.view_layers[0]
    copies = [_blank_copy(item.data) for item in items]
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
                    bpy.ops.mesh.reveal()
                    bpy.ops.mesh.select_all(action="SELECT")
                    bpy.ops.uv.smart_project(island_margin=0.0, area_weight=0.0, scale_to_bounds=False)
            finally:
                bpy.ops.object.mode_set(mode="OBJECT")
        return [
            _corner_uv(copy, copy.uv_layers[UV_LAYER], is_mirrored(item))
            for copy, item in zip(copies, items, strict=True)
        ]
    finally:
        bpy.data.batch_remove([*stand_ins, *copies])
        bpy.data.scenes.remove(scene)


def _blank_copy(mesh: bpy.types.Mesh) -> bpy.types.Mesh:
    """A copy with one empty UV layer."""
    copy = mesh.copy()
    while copy.uv_layers:
        copy.uv_layers.remove(copy.uv_layers[0])
    copy.uv_layers.new(name=UV_LAYER)
    return copy


def write_layer(item: bpy.types.Object, corner_uv: np.ndarray) -> None:
    """Write the FIPT layer of an object's mesh; the artist's active layers stay active.

    Args:
        item: an object with a mesh of ours.
        corner_uv: (T,3,2), the object's rows of atlas.npz.

    Raises:
        FiptError: ``uv-layers-full``.
    """
    mesh = item.data
    active, active_render = mesh.uv_layers.active_index, [layer.active_render for layer in mesh.uv_layers]
    layer = mesh.uv_layers.get(UV_LAYER) or mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    if layer is None:
        raise FiptError(
            "uv-layers-full",
            f"The mesh of '{item.name}' has 8 UV layers already; ours does not fit.",
            "Remove a UV layer, or choose colour attributes instead of UVs.",
        )
    loops, _ = triangle_loops(mesh, is_mirrored(item))
    uv = np.zeros((len(mesh.loops), 2), np.float32)
    uv[loops.ravel()] = corner_uv.reshape(-1, 2)
    mesh.uv_layers[UV_LAYER].uv.foreach_set("vector", uv.ravel())
    if active_render:
        mesh.uv_layers.active_index = active
        mesh.uv_layers[active_render.index(True) if True in active_render else 0].active_render = True


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
