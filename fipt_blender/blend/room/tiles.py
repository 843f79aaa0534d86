# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of an atlas of several images (UDIM): a material has one texture, and the UVs choose the image."""

from __future__ import annotations

import bpy
import numpy as np

from .mesh_arrays import corner_uvs, polygon_starts
from .uv_layer import UV_LAYER

_ROW = 10  # tiles side by side


def tile_number(image: int) -> int:
    """UDIM number of an atlas image, which counts from 0."""
    return 1001 + image


def tiled_uvs(corner_uv: np.ndarray, triangle_image: np.ndarray) -> np.ndarray:
    """(T, 3, 2) UVs in the tiles of atlas images.

    Args:
        corner_uv: (T, 3, 2) in the images.
        triangle_image: (T,) image of each triangle, negative for none.
    """
    image = np.maximum(triangle_image, 0)
    return corner_uv + np.stack([image % _ROW, image // _ROW], axis=1)[:, None].astype(corner_uv.dtype)


def image_uvs(uv: np.ndarray, image: np.ndarray) -> np.ndarray:
    """UVs (N, 2) in the tiles of atlas images (N,) as UVs in the images."""
    return uv - np.stack([image % _ROW, image // _ROW], axis=1).astype(uv.dtype)


def polygon_images(mesh: bpy.types.Mesh) -> np.ndarray:
    """(P,) int64 atlas image of each polygon, by the UVs of its corners."""
    if not len(mesh.polygons):
        return np.zeros(0, np.int64)
    uv = corner_uvs(mesh, mesh.uv_layers[UV_LAYER])
    starts = polygon_starts(mesh)
    size = np.diff(starts, append=len(uv))
    column, row = np.floor(np.add.reduceat(uv.astype(np.float64), starts, axis=0) / size[:, None]).T
    return (column + _ROW * row).astype(np.int64)
