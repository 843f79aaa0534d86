"""Parts as assets: materials of their mean values, with a picture of a ball.

On any other object the textures of a part would be one texel: only the room has the atlas's coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..color_spaces import from_scene_linear
from ..node_trees import node_tree
from ..png16 import encode_srgb
from .adjust import adjusted
from .part_list import adjustment

_LIGHT = np.array([-0.45, 0.5, 0.74])  # direction to the light, as seen from the camera at +z
_KEY, _FILL = 1.6, 0.55  # irradiance from the light, and from everywhere
TAG = "FIPT"


def mark_part(scene: bpy.types.Scene, part: bpy.types.PropertyGroup) -> bool:
    """Make or update the asset of a part; returns whether it has mean values to make one of."""
    if not part.known:
        return False
    means = np.array([[*part.base_color, part.roughness, part.metallic]])
    *color, roughness, metallic = adjusted(adjustment(scene, part.key), means)[0].tolist()
    ours = [each for each in bpy.data.materials if each.asset_data and TAG in each.asset_data.tags]
    material = next((each for each in ours if each.name == part.name), None)
    if material is None:
        material = bpy.data.materials.new(part.name)
        material.asset_mark()
        material.asset_data.tags.new(TAG)
    material.asset_data.description = f"Estimated from photographs: {part.name}"
    nodes = node_tree(material).nodes
    nodes.clear()
    principled, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    node_tree(material).links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    for name, value in (("Base Color", (*color, 1.0)), ("Roughness", roughness), ("Metallic", metallic)):
        principled.inputs[name].default_value = value
    _set_preview(material, ball(from_scene_linear(color).tolist(), roughness, metallic))
    return True


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
