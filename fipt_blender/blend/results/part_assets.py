# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of parts as assets, with a picture of a ball of the part's mean values.

Blender's own preview would show a texel of the atlas, whose coordinates only the room has.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..color_spaces import from_scene_linear
from ..png16 import encode_srgb
from .part_list import part_materials

_LIGHT = np.array([-0.45, 0.5, 0.74])  # direction to the light, as seen from the camera at +z
_KEY, _FILL = 1.6, 0.55  # irradiance from the light, and from everywhere
TAG = "FIPT"


def mark_part(scene: bpy.types.Scene, part: bpy.types.PropertyGroup) -> list[str]:
    """Mark the materials of a part as assets, with previews; returns their names."""
    materials = part_materials(scene, part.key)
    for material in materials:
        if material.asset_data is None:
            material.asset_mark()
        data = material.asset_data
        data.description = f"Estimated from photographs: {part.name}"
        if TAG not in data.tags:
            data.tags.new(TAG)
        _set_preview(
            material, ball(from_scene_linear(part.base_color).tolist(), part.roughness, part.metallic)
        )
    return [material.name for material in materials]


def _set_preview(material: bpy.types.Material, pixels: np.ndarray) -> None:
    preview = material.preview_ensure()
    preview.image_size = (pixels.shape[1], pixels.shape[0])
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())


def ball(base_color: Sequence[float], roughness: float, metallic: float, size: int = 128) -> np.ndarray:
    """A shaded ball (size, size, 4): display-referred RGBA, bottom row first.

    Lambert and GGX (Walter et al. 2007) under one light and an even surrounding, which is enough to
    distinguish colours, gloss and metals.
    """
    axis = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    x, y = np.meshgrid(axis / 0.92, axis / 0.92)
    inside = x**2 + y**2 < 1.0
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    light = _LIGHT / np.linalg.norm(_LIGHT)
    half = light + (0.0, 0.0, 1.0)
    half /= np.linalg.norm(half)
    facing = np.maximum(light[0] * x + light[1] * y + light[2] * z, 0.0)[..., None]
    along = np.maximum(half[0] * x + half[1] * y + half[2] * z, 0.0)
    color = np.asarray(base_color, float)
    squared = max(roughness, 0.08) ** 4
    lobe = squared / (np.pi * (along**2 * (squared - 1.0) + 1.0) ** 2)
    reflectance = 0.04 * (1.0 - metallic) + color * metallic
    grazing = reflectance + (1.0 - reflectance) * ((1.0 - z) ** 5)[..., None] * (1.0 - roughness)
    diffuse = color * (1.0 - metallic) * (_KEY * facing + _FILL)
    glossy = reflectance * lobe[..., None] * 0.25 * _KEY * facing + grazing * _FILL
    shown = encode_srgb(diffuse / 1.6 + glossy)
    return np.concatenate([shown * inside[..., None], inside[..., None]], axis=2).astype(np.float32)
