"""The atlas that the engine bakes onto: UVs of the whole room in few images, written to atlas.npz.

UVs that the artist made are kept where they can hold a texture, other objects are unwrapped; all islands are
then scaled to one texel density and packed into few images.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...bridge.step import Slices
from ...core.run.errors import FiptError
from ...core.run.names import free_name
from ...core.run.parts import read_parts
from ...core.run.result_contents import AtlasImage, AtlasImages
from ...core.run.run_files import AtlasArrays, Resolution, RoomMesh, read_room
from ...core.run.runfolder import RunFolder, write_json
from ...core.run.settings import Settings
from ...core.run.store import optional_arrays, write_arrays
from ..slices import find_object
from .islands import island_bounds, rotate_islands, split_islands, triangle_areas, uv_islands
from .packing import PAD, pack_apart, pack_islands, place
from .result_meshes import match_objects
from .unwrapping import (
    UnwrapSource,
    exported_source,
    is_scan,
    read_source,
    unwrap,
    uvs_in_range,
    uvs_usable,
)

MAX_IMAGES = 16
# Where photographs have more detail than light, the density is what they resolve on each island, within these
# images of the preset's width and height; between the setting's density and the highest one.
DETAIL_IMAGES = 4
DETAIL_SIZES = {"draft": 2048, "medium": 4096, "high": 8192}
# UVs of scans are rounded to this share of an image, a 32nd of a texel or less: they compress to two thirds.
UV_STEP = 2.0**-16


@dataclass(frozen=True)
class _RoomIslands:
    """The room's triangles on their way into the atlas.

    Attributes:
        uv: (T,3,2) f64 by triangle corner, each object in its own UV space.
        island: (T,) i64, numbered within each object.
        area: (T,) f64 in the world, m².
        is_scan: (T,) bool, whether they are a scan's that was unwrapped.
    """

    uv: np.ndarray
    island: np.ndarray
    area: np.ndarray
    is_scan: np.ndarray


def make_atlas(
    objects: Iterable[bpy.types.Object], run: RunFolder, settings: Settings, max_images: int = MAX_IMAGES
) -> Slices[None]:
    """Lay the room out for baking: write atlas.npz and atlas.json, a few objects per slice.

    Args:
        objects: the objects that `export_room` wrote, in any order, which are not changed; of those that are
            missing or changed the exported triangles are unwrapped, so that the atlas holds the whole room.
        run: the run folder with its room.
        settings: texel_density, texture_size, atlas_images and atlas_mode are used.
        max_images: where more were needed, all islands are scaled down instead.
    """
    room = read_room(run)
    count = len(room.triangles)
    if settings.atlas_mode == "color_attribute":
        _write(run, np.zeros((count, 3, 2)), np.full(count, -1), "color_attribute", [], [])
        return
    matches = match_objects(room, objects)
    yield None
    areas = triangle_areas(room.vertices[room.triangles])
    islands = _RoomIslands(
        np.zeros((count, 3, 2)), np.full(count, -1, np.int64), areas, np.zeros(count, bool)
    )
    tasks: list[tuple[int, UnwrapSource]] = []  # objects that are unwrapped
    for index, match in enumerate(matches):
        triangles = np.flatnonzero(room.triangle_object == index)
        source = None
        if match is not None:
            item = find_object(match)
            try:
                source = read_source(room, index, item)
            except FiptError as error:
                if error.code != "room-changed":
                    raise
        if source is None:
            source = exported_source(room, index)
        if source.uv is not None and uvs_in_range(source.uv):
            object_island = uv_islands(room.triangles[triangles], source.uv)
            if uvs_usable(source.uv, object_island, areas[triangles]):
                islands.uv[triangles] = source.uv
                islands.island[triangles] = object_island
                yield None
                continue
        islands.is_scan[triangles] = is_scan(areas[triangles])
        tasks.append((index, source))
        yield None
    for batch in _batches(tasks):
        rows = [np.flatnonzero(room.triangle_object == index) for index, _ in batch]
        scans = [bool(islands.is_scan[triangles].any()) for triangles in rows]
        for triangles, uv in zip(rows, unwrap([source for _, source in batch], scans), strict=True):
            islands.uv[triangles] = uv
            islands.island[triangles] = uv_islands(room.triangles[triangles], uv)
        yield None
    found = optional_arrays(run.resolution_npz, Resolution) if settings.detail else None
    resolved = None if found is None else found.density
    if resolved is not None:
        size = max(settings.texture_size, DETAIL_SIZES.get(settings.preset, 0))
        settings, max_images = replace(settings, texture_size=size), min(max_images, DETAIL_IMAGES)
    owners = _image_owners(room, run, settings)
    yield from _pack_room(room, islands, run, settings, max_images, resolved, owners)


@dataclass(frozen=True)
class _Owners:
    """What lies on as few images as possible, or on an image of its own.

    Attributes:
        triangle: (T,) int, the owner of each triangle.
        names: of the owners.
        apart: whether each has an image of its own.
    """

    triangle: np.ndarray
    names: list[str]
    apart: bool


def _image_owners(room: RoomMesh, run: RunFolder, settings: Settings) -> _Owners:
    """The objects where each has an image of its own, else the parts."""
    if settings.atlas_images == "object":
        return _Owners(room.triangle_object.astype(np.int64), list(room.objects), True)
    parts = read_parts(run, room.triangle_object, room.objects)
    names = [part.name for part in parts.parts]
    return _Owners(parts.triangle.astype(np.int64), names, settings.atlas_images == "part")


def _batches(tasks: list[tuple[int, UnwrapSource]]) -> Iterator[list[tuple[int, UnwrapSource]]]:
    """Objects that are unwrapped in one slice, about 50 ms: many small ones, or a large one."""
    batch: list[tuple[int, UnwrapSource]] = []
    for task in tasks:
        if batch and sum(len(source.loop_vertex) for _, source in (*batch, task)) > 20_000:
            yield batch
            batch = []
        batch.append(task)
    if batch:
        yield batch


def _pack_room(
    room: RoomMesh,
    islands: _RoomIslands,
    run: RunFolder,
    settings: Settings,
    max_images: int,
    resolved: np.ndarray | None,
    owners: _Owners,
) -> Slices[None]:
    """Scale all islands to one density, or to that of the photographs, pack them and write the atlas.

    Args:
        resolved: (T,) texels a metre that photographs resolve, NaN where unseen; None for one density.
        owners: of the images.
    """
    # Number the islands over the whole room.
    stride = int(islands.island.max(initial=0)) + 1
    number = room.triangle_object.astype(np.int64) * stride + islands.island
    if owners.apart:  # an island may extend over several parts
        number = number * len(owners.names) + owners.triangle
    _, island = np.unique(number, return_inverse=True)
    island_count = int(island.max(initial=-1)) + 1

    # Islands without area in space or in the plane can't hold texels.
    world_area = np.bincount(island, islands.area, island_count)
    flat_area = np.bincount(island, triangle_areas(islands.uv), island_count)
    packed = ((world_area > 1e-12) & (flat_area > 1e-14))[island]  # (T,)
    wanted = _island_density(resolved, island, islands.area, island_count, settings.texel_density)
    density = wanted * _island_scale(room.triangle_object, island, world_area, flat_area)
    texels = islands.uv[packed] * density[island[packed]][:, None, None]
    owner = room.triangle_object[packed].astype(np.int64)
    polygon = room.triangle_polygon[packed]
    packed_island = np.zeros(len(texels), np.int64)
    count = 0
    for index in np.unique(owner):
        triangles = np.flatnonzero(owner == index)
        object_island = np.unique(island[packed][triangles], return_inverse=True)[1]
        rotated = rotate_islands(texels[triangles], object_island)
        object_island = split_islands(
            rotated, object_island, polygon[triangles], settings.texture_size - 2 * PAD
        )
        texels[triangles] = rotate_islands(rotated, object_island)
        packed_island[triangles] = object_island + count
        count += int(object_island.max()) + 1
        yield None
    low, extent = island_bounds(texels, packed_island)
    group = np.zeros(len(low), np.int64)
    group[packed_island] = owners.triangle[packed]
    if owners.apart:
        packing = pack_apart(extent, group, settings.texture_size)
    else:
        packing = pack_islands(extent, group, settings.texture_size, max_images=max_images)
    placed = place(texels, packed_island, low, packing)

    image = np.full(len(room.triangles), -1, np.int64)
    image[packed] = packing.image[packed_island]
    sizes = np.array(packing.sizes, np.float64).reshape(-1, 2)
    corner_uv = np.zeros_like(islands.uv)
    corner_uv[packed] = placed / sizes[image[packed]][:, None]
    corner_uv[islands.is_scan] = np.round(corner_uv[islands.is_scan] / UV_STEP) * UV_STEP
    names = [f"Room.{index + 1:03d}" for index in range(len(packing.sizes))]
    if owners.apart:
        names = file_names([owners.names[index] for index in np.unique(group).tolist()])
    _write(run, corner_uv, image, "uv", packing.sizes, names)
    if not len(packing.scale):
        raise FiptError("mesh-empty.pack-room")


def _island_density(
    resolved: np.ndarray | None, island: np.ndarray, area: np.ndarray, count: int, least: float
) -> np.ndarray:
    """(count,) texels a metre wanted of each island: the mean over its area of what photographs resolve."""
    if resolved is None:
        return np.full(count, least)
    seen = np.isfinite(resolved)
    weight = np.maximum(area, 1e-12) * seen
    total = np.bincount(island, weight * np.nan_to_num(resolved), count)
    mean = total / np.maximum(np.bincount(island, weight, count), 1e-30)
    return np.clip(mean, least, max(2000.0, least))  # texels a metre


def _island_scale(
    triangle_object: np.ndarray, island: np.ndarray, world_area: np.ndarray, flat_area: np.ndarray
) -> np.ndarray:
    """Metres per UV unit of each island, (N,) f64.

    At most twice that of its object: an island seen edge-on in its map would otherwise fill an image.
    """
    owner = np.zeros(len(world_area), np.int64)
    owner[island] = triangle_object
    object_ratio = np.bincount(owner, world_area) / np.maximum(np.bincount(owner, flat_area), 1e-30)
    island_ratio = world_area / np.maximum(flat_area, 1e-30)
    return np.sqrt(np.minimum(island_ratio, 4.0 * object_ratio[owner]))


def _write(
    run: RunFolder,
    corner_uv: np.ndarray,
    image: np.ndarray,
    mode: str,
    sizes: list[tuple[int, int]],
    names: list[str],
) -> None:
    """Write atlas.npz and atlas.json with the names and sizes of the images."""
    write_arrays(run.atlas_npz, AtlasArrays(corner_uv.astype(np.float32), image.astype(np.int32)))
    images = tuple(AtlasImage(name, *size) for name, size in zip(names, sizes, strict=True))
    write_json(run.atlas_json, AtlasImages(mode, images))


def file_names(owners: list[str]) -> list[str]:
    """Names of files for all systems, of which some do not distinguish capitals from small letters."""
    taken: set[str] = set()
    names = []
    for owner in owners:
        name = re.sub(r"[^\w-]+", "_", owner).strip("_")[:60] or "Part"
        names.append(free_name(name, taken, "_", str.casefold))
        taken.add(names[-1].casefold())
    return names
