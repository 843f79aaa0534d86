# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures for other programs: 8-bit PNGs of an atlas image, with the artist's adjustments in their values.

Base colour has sRGB's transfer function; roughness (green) and metallic (blue) share an image, as in glTF.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np

from ...core.textures.raster import covered_texels
from ..color_spaces import from_scene_linear
from ..image_datablocks import tile_values
from ..marks import MAP
from ..node_trees import node_tree
from ..png16 import encode_srgb
from ..results import adjust
from ..room.tiles import tile_number

# Texels around a face that take the adjustment of its part: the reach of filters.
MARGIN = 4.0
_LABELS = ("Base Color", "Roughness", "Metallic")


def read_maps(material: bpy.types.Material, atlas_image: int) -> np.ndarray:
    """(H, W, 5) base colour (scene-linear), roughness, metallic of a material's atlas image, bottom row
    first.

    Raises:
        FiptError: ``file-missing``.
    """
    columns = []
    for label, channels in zip(_LABELS, (3, 1, 1), strict=True):
        image = node_tree(material).nodes[MAP.format(label)].image
        columns.append(tile_values(image, tile_number(atlas_image))[..., :channels])
    return np.concatenate(columns, axis=2)


def texel_parts(corner_uv: np.ndarray, part: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Part of each texel of an atlas image, of the nearest triangle within MARGIN; -1 elsewhere.

    Args:
        corner_uv: (T, 3, 2) of the triangles on the image.
        part: (T,) int of each triangle.
        size: width and height of the image.

    Returns:
        (height, width) int64, bottom row first.
    """
    width, height = size
    result = np.full(width * height, -1, np.int64)
    nearest = np.full(width * height, np.inf, np.float32)
    corners = corner_uv.astype(np.float64) * (width, height)
    for texel, triangle, _, distance in covered_texels(corners, width, height, MARGIN):
        order = np.argsort(-distance, kind="stable")  # the last assignment to a texel wins
        texel, triangle, distance = texel[order], triangle[order], distance[order]
        closer = distance < nearest[texel]
        result[texel[closer]] = part[triangle[closer]]
        nearest[texel[closer]] = distance[closer]
    return result.reshape(height, width)


def adjusted_maps(
    maps: np.ndarray, texel_part: np.ndarray, adjustments: Mapping[int, adjust.Adjustment]
) -> np.ndarray:
    """Maps (H, W, 5) with the adjustment of each texel's part; parts without an entry stay as they are."""
    result = maps.copy()
    for part, values in adjustments.items():
        chosen = texel_part == part
        result[chosen] = adjust.adjusted(values, maps[chosen])
    return result


def write_png(values: np.ndarray, path: Path, is_data: bool) -> bpy.types.Image:
    """A new image of scene-linear values (H, W, 3), bottom row first, saved as an 8-bit PNG.

    Args:
        values: 0 to 1.
        path: of the file.
        is_data: whether they are not colours, and stored as they are.
    """
    height, width, _ = values.shape
    image = bpy.data.images.new(path.stem, width, height, alpha=False, is_data=is_data)
    pixels = np.ones((height, width, 4), np.float32)
    # Blender's byte images hold what is stored in the file.
    pixels[..., :3] = values if is_data else encode_srgb(from_scene_linear(values))
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    image.source = "FILE"
    return image
