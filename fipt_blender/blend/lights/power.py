"""A light's power as Blender counts it, in watts, and in lumens. Imported while panels draw."""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Matrix

from ..marks import BASE
from ..room.mesh_arrays import polygon_slots
from .color import LUMENS_PER_WATT, Rgb, luminance
from .fixture_nodes import surfaces
from .tint import base_of, blender_color, shone, split


def has_power(item: bpy.types.Object) -> bool:
    """Whether a light has a power in watts."""
    return item.type == "MESH" or (item.type == "LIGHT" and item.data.type != "SUN")


def world_matrix(item: bpy.types.Object) -> Matrix:
    """An object's matrix to the world, also where it has just been made or moved, without parent."""
    return item.matrix_basis if item.parent is None else item.matrix_world


def slot_areas(item: bpy.types.Object) -> np.ndarray:
    """(S,) area of the faces of each material slot of a fixture in the world, m²; the scale is uniform."""
    mesh = item.data
    area = np.empty(len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("area", area)
    count = max(len(mesh.materials), 1)
    slot = np.minimum(polygon_slots(mesh), count - 1)
    return np.bincount(slot, area, minlength=count) * world_matrix(item).median_scale ** 2


def base_power(item: bpy.types.Object) -> Rgb:
    """Watts (rgb) of a light as estimated or added: pi A L of both sides of a fixture's surfaces."""
    if item.type != "MESH":
        red, green, blue = item.get(BASE, (0.0, 0.0, 0.0))
        return (red, green, blue)
    area, total = slot_areas(item), np.zeros(3)
    for surface in surfaces(item):
        total += math.pi * area[surface.slot] * (np.array(surface.front) + np.array(surface.back))
    red, green, blue = total.tolist()
    return (red, green, blue)


def watts(item: bpy.types.Object) -> float:
    """A light's power, as in the field Power of a Blender light: that of its strongest channel."""
    return blender_color(shone(item, base_power(item)))[1]


def lumens(item: bpy.types.Object) -> float:
    """A light's luminous flux: of a diffuse surface 683 pi A times the luminance of its radiance."""
    return LUMENS_PER_WATT * luminance(shone(item, base_power(item)))


def radiance(item: bpy.types.Object) -> float:
    """Radiance of a fixture's brighter side, of its strongest channel, W/(m² sr); joined lamps: the first."""
    return split(shone(item, base_of(item)))[1]


def stops_for(value: float, present: float, stops: float) -> float:
    """The power in stops at which a quantity, `present` at `stops`, has a value; unchanged for none."""
    if present <= 0.0 or value <= 0.0:
        return stops
    return stops + math.log2(value / present)
