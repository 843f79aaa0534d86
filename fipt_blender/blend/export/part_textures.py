# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures for other programs: one set of 8-bit PNGs for each part, with the artist's adjustments in them.

The islands of a part lie on any image of the atlas. Here they are packed again: a part is one material.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..color_spaces import from_scene_linear
from ..image_datablocks import tile_values
from ..marks import MAP, MATERIAL, PART
from ..node_trees import node_tree
from ..png16 import encode_srgb
from ..results import adjust
from ..room.atlas import file_names
from ..room.islands import island_bounds, uv_islands
from ..room.mesh_arrays import corner_uvs, corner_vertices, polygon_slots, triangle_loops
from ..room.packing import PAD, pack_apart
from ..room.tiles import image_uvs, polygon_images, tile_number
from ..room.uv_layer import UV_LAYER, write_layer

# Width and height of the largest texture of a part, in texels, unless another is chosen.
TEXTURE_SIZE = 4096
_LABELS = ("Base Color", "Roughness", "Metallic")


@dataclass(frozen=True)
class PartTextures:
    """The exported textures of a part.

    Attributes:
        base_color: sRGB.
        orm: occlusion (1: none), roughness and metallic in red, green and blue, as in glTF.
    """

    base_color: bpy.types.Image
    orm: bpy.types.Image


@dataclass(frozen=True)
class _Faces:
    """The triangles of all meshes that show parts.

    Attributes:
        loops: (T,3) face corners, counted through all meshes.
        island: (T,) of `uv_islands`.
        owner: (T,) index of the part.
        source: (T,) index of the atlas image in `sources`.
        corners: (T,3,2) in texels of that image.
        sources: a material that has the image, and the image's number in its atlas.
    """

    loops: np.ndarray
    island: np.ndarray
    owner: np.ndarray
    source: np.ndarray
    corners: np.ndarray
    sources: list[tuple[bpy.types.Material, int]]


def make_part_textures(
    meshes: list[bpy.types.Mesh],
    names: Mapping[bpy.types.Material, str],
    folder: Path,
    size: int,
    prefix: str = "",
) -> dict[bpy.types.Material, PartTextures]:
    """Write the textures of parts, and give meshes the UVs of these in place of those of the atlas.

    Args:
        meshes: copies of all objects with results, as renders show them.
        names: of the estimated materials with images; those of one part and name share textures.
        folder: for the files.
        size: the most texels of a texture's side; parts that need more are scaled down.
        prefix: of the files' names.

    Raises:
        FiptError: ``file-missing``.
    """
    if not names:
        return {}
    owners = list(dict.fromkeys((material[PART], name) for material, name in names.items()))
    faces = _faces(meshes, {each: owners.index((each[PART], name)) for each, name in names.items()})
    low, extent = island_bounds(faces.corners, faces.island)
    rows = np.zeros((len(low), 6), np.int64)
    rows[faces.island, 0], rows[faces.island, 1] = faces.owner, faces.source
    rows[:, 2:4], rows[:, 4:] = np.floor(low), np.maximum(np.ceil(low + extent), np.floor(low) + 1)
    boxes, box = np.unique(rows, axis=0, return_inverse=True)  # copies, as of an array, share their texels
    box = box.ravel()[faces.island]
    packing = pack_apart(boxes[:, 4:] - boxes[:, 2:4], boxes[:, 0], size)
    texels = [np.zeros((height, width, 5), np.uint8) for width, height in packing.sizes]
    filled = [np.zeros((height, width), bool) for width, height in packing.sizes]
    adjustments = {owners.index((each[PART], name)): adjust.read(each) for each, name in names.items()}
    for number, (material, image) in enumerate(faces.sources):
        maps = _read_maps(material, image)
        for index in np.flatnonzero(boxes[:, 1] == number).tolist():
            pad = int(packing.pad[index])
            region = _region(maps, boxes[index, 2:4], boxes[index, 4:], packing.scale[index], pad)
            values = adjust.adjusted(adjustments[boxes[index, 0]], region.reshape(-1, 5))
            encoded = np.concatenate([encode_srgb(from_scene_linear(values[:, :3])), values[:, 3:]], axis=1)
            x, y = (packing.offset[index] - pad).astype(int).tolist()
            place = np.s_[y : y + region.shape[0], x : x + region.shape[1]]
            codes = np.round(np.clip(encoded, 0.0, 1.0) * 255.0).reshape(region.shape)
            texels[packing.image[index]][place], filled[packing.image[index]][place] = codes, True
    for pixels, has_island in zip(texels, filled, strict=True):  # what small mip levels mix in
        pixels[~has_island] = pixels[has_island].mean(axis=0)
    placed = (faces.corners - boxes[box][:, None, 2:4]) * packing.scale[box][:, None, None]
    sizes = np.array(packing.sizes, np.float64).reshape(-1, 2)[packing.image[box]]
    _write_uvs(meshes, faces.loops, (placed + packing.offset[box][:, None]) / sizes[:, None])
    used = [owners[index] for index in np.unique(boxes[:, 0])]  # others have no face
    files = [prefix + name for name in file_names([name for _, name in used])]
    made = {owner: _write(each, folder, file) for owner, each, file in zip(used, texels, files, strict=True)}
    return {each: made[each[PART], name] for each, name in names.items() if (each[PART], name) in made}


def _faces(meshes: list[bpy.types.Mesh], owner_of: Mapping[bpy.types.Material, int]) -> _Faces:
    """The triangles in all meshes that show materials, each of which belongs to an owner."""
    materials = list(owner_of)
    loops, vertices, uvs, shown, image = [], [], [], [], []
    first_loop = first_vertex = 0
    for mesh in meshes:
        corners, polygons = triangle_loops(mesh, False)
        of_slot = [materials.index(each) if each in owner_of else -1 for each in mesh.materials] or [-1]
        material = np.array(of_slot)[np.minimum(polygon_slots(mesh), len(of_slot) - 1)][polygons]
        corners, polygons = corners[material >= 0], polygons[material >= 0]
        shown.append(material[material >= 0])
        loops.append(corners.astype(np.int64) + first_loop)
        vertices.append(corner_vertices(mesh)[corners].astype(np.int64) + first_vertex)
        uvs.append(corner_uvs(mesh, mesh.uv_layers[UV_LAYER])[corners])
        image.append(polygon_images(mesh)[polygons])
        first_loop, first_vertex = first_loop + len(mesh.loops), first_vertex + len(mesh.vertices)
    corner_uv, material, number = np.concatenate(uvs), np.concatenate(shown), np.concatenate(image)
    owner = np.array(list(owner_of.values()), np.int64)[material]
    atlases = [each[MATERIAL] for each in materials]
    atlas = np.array([atlases.index(each) for each in atlases], np.int64)[material]
    pairs, source = np.unique(np.stack([atlas, number], axis=1), axis=0, return_inverse=True)
    source = source.ravel()
    # An island may extend over several parts.
    keys = np.stack([uv_islands(np.concatenate(vertices), corner_uv), owner, source], axis=1)
    island = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    sources = [(materials[first], of_image) for first, of_image in pairs.tolist()]
    for index, (first, of_image) in enumerate(sources):
        chosen = source == index
        corner_uv[chosen] = image_uvs(corner_uv[chosen], of_image) * _size(first, of_image)
    return _Faces(np.concatenate(loops), island, owner, source, corner_uv, sources)


def _image(material: bpy.types.Material, label: str) -> bpy.types.Image:
    return node_tree(material).nodes[MAP.format(label)].image


def _size(material: bpy.types.Material, atlas_image: int) -> np.ndarray:
    """(2,) width and height of an atlas image."""
    image = _image(material, _LABELS[0])
    tile = image.tiles.get(tile_number(atlas_image)) if image.source == "TILED" else None
    return np.array(image.size if tile is None else tile.size, np.float64)


def _read_maps(material: bpy.types.Material, atlas_image: int) -> np.ndarray:
    """(H, W, 5) base colour (scene-linear), roughness, metallic of an atlas image, bottom row first."""
    columns = []
    for label, channels in zip(_LABELS, (3, 1, 1), strict=True):
        values = tile_values(_image(material, label), tile_number(atlas_image))
        columns.append(values[..., :channels])
    return np.concatenate(columns, axis=2)


def _region(maps: np.ndarray, low: np.ndarray, high: np.ndarray, scale: float, pad: int) -> np.ndarray:
    """A box of maps (H, W, C) scaled down, with `pad` texels around it: mean values of what they cover.

    Args:
        maps: of an atlas image.
        low, high: (2,) int, x and y of the box, texels.
        scale: 0 to 1; at 1 the texels are copied.
        pad: texels of the result.
    """
    reach = math.ceil(pad / scale) + 1
    # Beyond the margin that baking fills lie other parts: there, the margin's last texel goes on.
    ranges = [np.arange(first - reach, last + reach).clip(first - PAD, last + PAD - 1)
              for first, last in zip(low.tolist(), high.tolist(), strict=True)]  # fmt: skip
    columns, rows = (each.clip(0, most - 1) for each, most in zip(ranges, maps.shape[1::-1], strict=True))
    result = maps[np.ix_(rows, columns)].astype(np.float64)
    for axis, extent in enumerate((high - low)[::-1].tolist()):
        count = math.ceil(extent * scale - 1e-6) + 2 * pad
        edges = np.minimum((np.arange(count + 1) - pad) / scale + reach, result.shape[axis])
        result = _means(np.moveaxis(result, axis, 0), edges)
        result = np.moveaxis(result, 0, axis)
    return result


def _means(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means of (N, ...) samples, each of which fills one unit, between neighbouring edges (M,)."""
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    before = np.minimum(edges.astype(np.int64), len(values) - 1)
    shape = (-1,) + (1,) * (values.ndim - 1)
    until = sums[before] + (sums[before + 1] - sums[before]) * (edges - before).reshape(shape)
    return np.diff(until, axis=0) / np.maximum(np.diff(edges), 1e-9).reshape(shape)


def _write_uvs(meshes: list[bpy.types.Mesh], loops: np.ndarray, corner_uv: np.ndarray) -> None:
    """Write UVs (T,3,2) of the face corners (T,3), which are counted through all meshes; others get 0."""
    uv = np.zeros((sum(len(mesh.loops) for mesh in meshes), 2))
    uv[loops.ravel()] = corner_uv.reshape(-1, 2)
    first = 0
    for mesh in meshes:
        write_layer(mesh, uv[first : first + len(mesh.loops)])
        first += len(mesh.loops)


def _write(codes: np.ndarray, folder: Path, name: str) -> PartTextures:
    """Save the textures of 8-bit codes (H, W, 5), bottom row first."""
    orm = np.concatenate([np.full_like(codes[..., :1], 255), codes[..., 3:]], axis=2)
    return PartTextures(
        _write_png(codes[..., :3], folder / f"{name}_base_color.png", False),
        _write_png(orm, folder / f"{name}_orm.png", True),
    )


def _write_png(codes: np.ndarray, path: Path, is_data: bool) -> bpy.types.Image:
    """A new image of 8-bit codes (H, W, 3), bottom row first, saved as PNG."""
    height, width, _ = codes.shape
    image = bpy.data.images.new(path.stem, width, height, alpha=False, is_data=is_data)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = codes / np.float32(255.0)  # byte images hold what is stored in the file
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    image.source = "FILE"
    return image
