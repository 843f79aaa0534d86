"""New lights: Blender's of a shape, and rectangles of known radiance."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..outliner import LIGHTS, collection
from .fixture_nodes import emission_material


def add_area_light(
    name: str,
    radiance: Sequence[float],
    corners: Sequence[Sequence[float]],
    scene: bpy.types.Scene | None = None,
) -> bpy.types.Object:
    """Add an emissive rectangle, which cameras and mirrors see; its back is black.

    Args:
        name: name of the new object.
        radiance: rgb, W/(m² sr), of its front.
        corners: (4,3) in the world, counter-clockwise seen from its front.
        scene: the context's scene by default.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, corner)) for corner in corners], [], [(0, 1, 2, 3)])
    mesh.materials.append(emission_material(name, list(radiance), [0.0, 0.0, 0.0]))
    item = bpy.data.objects.new(name, mesh)
    collection(scene or bpy.context.scene, LIGHTS).objects.link(item)
    return item


def shaped_light(name: str, shape: str, width: float, height: float) -> bpy.types.Object:
    """A Blender light in no scene: a ball ("POINT"), or an area light of one of Blender's shapes; metres."""
    data = bpy.data.lights.new(name, "POINT" if shape == "POINT" else "AREA")
    if shape != "POINT":
        data.shape, data.size, data.size_y = shape, width, height
    else:
        data.shadow_soft_size = 0.5 * width
        if hasattr(data, "use_soft_falloff"):  # without it the falloff is that of a sphere
            data.use_soft_falloff = False
    return bpy.data.objects.new(name, data)
