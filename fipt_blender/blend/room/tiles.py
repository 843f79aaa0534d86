# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of an atlas of several images (UDIM): a material has one texture, and the UVs choose the image."""

from __future__ import annotations

import numpy as np

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
