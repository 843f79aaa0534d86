"""Lights that Blender's exporters do not make: of glowing surfaces, and spots in place of area lights."""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..lights.color import LUMINANCE
from ..lights.convert import is_closed, vector_areas, world_triangles
from ..lights.fixture_nodes import is_emission_material, side_radiance
from ..lights.tint import split
from ..room.mesh_arrays import polygon_slots, triangle_loops

# Metres by which the light of a lamp stands before its surface, which shadow maps would take for a blocker.
_BEFORE = 0.01
# Angle of the cone of a lamp's spot: browsers draw shadow maps of no hemisphere.
_CONE = math.radians(170.0)
# A lamp is a spot if its mean normal, weighted by power, is longer than this; a hemisphere's has 0.5.
_DIRECTED = 0.8


def area_spot(item: bpy.types.Object) -> bpy.types.Light:
    """A new spot of the power of an area light, which glTF does not have, for the matrix of `turned`."""
    light = item.data
    power = light.energy * 2.0 ** getattr(light, "exposure", 0.0) * np.array(light.color, np.float64)
    if getattr(light, "use_temperature", False):
        power *= np.array(light.temperature_color)
    if not getattr(light, "normalize", True):
        power *= light.area(matrix_world=item.matrix_world)
    return wide_spot(power)


def has_default_nodes(light: bpy.types.Light) -> bool:
    """Whether a light has the nodes that Blender gives it, which change nothing."""
    nodes = [] if light.node_tree is None else list(light.node_tree.nodes)
    emission = next((node for node in nodes if node.bl_idname == "ShaderNodeEmission"), None)
    if emission is None or len(nodes) > 2 or any(socket.is_linked for socket in emission.inputs):
        return False
    color, strength = (emission.inputs[name].default_value for name in ("Color", "Strength"))
    return tuple(color) == (1.0,) * 4 and strength == 1.0


def lamp_light(item: bpy.types.Object) -> tuple[bpy.types.Light, Matrix] | None:
    """A new light of the power and color of a fixture's surfaces, and its matrix to the world.

    It is a spot for a lamp that shines to one side, otherwise a point. None where nothing emits.
    """
    vertices, triangles = world_triangles(item)
    vectors = vector_areas(vertices, triangles)
    slots = polygon_slots(item.data)[triangle_loops(item.data, False)[1]]
    front, back = np.zeros((2, len(slots), 3))
    for index, slot in enumerate(item.material_slots):
        if slot.material is not None and is_emission_material(slot.material):
            front[slots == index], back[slots == index] = side_radiance(slot.material)
    if is_closed(vectors):
        back[:] = 0.0  # the inside
    areas = np.linalg.norm(vectors, axis=1)
    total = (front + back).T @ areas  # (3,) area times radiance
    weight = areas * ((front + back) @ LUMINANCE)
    if total.max(initial=0.0) <= 0.0:
        return None
    place = Vector((vertices[triangles].mean(axis=1).T @ weight / weight.sum()).tolist())
    axis = Vector((vectors.T @ ((front - back) @ LUMINANCE)).tolist())
    if axis.length <= _DIRECTED * weight.sum():
        light = bpy.data.lights.new("Light", "POINT")
        light.color, light.energy = split((math.pi * total).tolist())
        light.shadow_soft_size = 0.0
        return without_nodes(light), Matrix.Translation(place)
    turn = axis.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    return wide_spot(math.pi * total), Matrix.Translation(place + _BEFORE * axis.normalized()) @ turn


def wide_spot(watts: np.ndarray) -> bpy.types.Light:
    """A new spot that sends out so many watts (rgb), as a surface sends them to its front.

    Its edge is blended over the whole cone: readers then show about the cosine of a surface. With a
    smoothstep of the cosine from that of the edge, e, to 1, a spot of intensity I sends out pi I (1 - e).
    Blender takes the power of a spot for that of a point light, 4 pi I.
    """
    light = bpy.data.lights.new("Light", "SPOT")
    light.color, light.energy = split((4.0 * watts / (1.0 - math.cos(0.5 * _CONE))).tolist())
    light.spot_size, light.spot_blend, light.shadow_soft_size = _CONE, 1.0, 0.0
    return without_nodes(light)


def without_nodes(light: bpy.types.Light) -> bpy.types.Light:
    """Without nodes, of which exporters of some versions take the color, white."""
    if light.node_tree is not None:
        light.node_tree.nodes.clear()
    return light


def turned(matrix: Matrix) -> Matrix:
    """A matrix to the world without scale, shear and mirroring, along whose -Z a light shines."""
    across, back = matrix.col[0].to_3d().normalized(), matrix.col[2].to_3d().normalized()
    up = back.cross(across).normalized()
    rotation = Matrix((up.cross(back), up, back)).transposed().to_4x4()
    rotation.translation = matrix.translation
    return rotation
