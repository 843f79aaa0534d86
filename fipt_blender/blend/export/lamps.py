# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps for other programs, whose surfaces have one emission for both sides, and which light by lights."""

from __future__ import annotations

import math

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..lights.color import LUMINANCE
from ..lights.convert import is_closed, vector_areas, world_triangles
from ..lights.fixture_nodes import is_emission_material, side_radiance
from ..lights.tint import split
from ..room.mesh_arrays import polygon_slots, triangle_loops
from .materials import glowing_material

# Metres between the front and the back of a lamp whose sides emit differently.
GAP = 5e-4
# Metres by which the light of a lamp stands before its surface, which shadow maps would take for a blocker.
_BEFORE = 0.01
# Angle of the cone of a lamp's spot: browsers draw shadow maps of no hemisphere.
_CONE = math.radians(170.0)
# A lamp is a spot if its mean normal, weighted by power, is longer than this; a hemisphere's has 0.5.
_DIRECTED = 0.8
_BLACK = (0.0, 0.0, 0.0)


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
        return _without_nodes(light), Matrix.Translation(place)
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
    return _without_nodes(light)


def _without_nodes(light: bpy.types.Light) -> bpy.types.Light:
    """Without nodes, of which exporters of some versions take the color, white."""
    if light.node_tree is not None:
        light.node_tree.nodes.clear()
    return light


def plain_lamp(
    item: bpy.types.Object, lit: bool, unit: float
) -> list[tuple[bpy.types.Material, bpy.types.Material, str]]:
    """Give a copy of a fixture materials that emit alike on both sides.

    A lamp whose sides emit differently gets a second surface closely behind the first one. The inside of a
    closed lamp emits nothing, and no side does where the lamp is not `lit`.

    Args:
        item: the copy.
        lit: whether it emits.
        unit: by which radiance is multiplied.

    Returns:
        The new materials, those that they stand for, and what is to follow the names of these.
    """
    made: list[tuple[bpy.types.Material, bpy.types.Material, str]] = []
    behind: dict[int, int] = {}
    closed = is_closed(vector_areas(*world_triangles(item)))
    for index, slot in enumerate(list(item.material_slots)):
        material = slot.material
        if material is None or not is_emission_material(material):
            continue
        front, back = unit * np.array(side_radiance(material) if lit else (_BLACK, _BLACK))
        alike = np.allclose(front, back, rtol=1e-3)
        made.append((glowing_material(material.name, front.tolist(), not alike), material, ""))
        slot.material = made[-1][0]
        if not alike and not closed:
            made.append((glowing_material(material.name, back.tolist(), True), material, " Back"))
            item.data.materials.append(made[-1][0])
            behind[index] = len(item.material_slots) - 1
    if behind:
        add_backs(item.data, behind, GAP / max(item.matrix_world.median_scale, 1e-6))
    return made


def add_backs(mesh: bpy.types.Mesh, behind: dict[int, int], gap: float) -> None:
    """Double the faces of some material slots, turned and moved backwards, with the slots of their backs."""
    made = bmesh.new()
    made.from_mesh(mesh)
    made.normal_update()
    faces = [face for face in made.faces if face.material_index in behind]
    copies = bmesh.ops.duplicate(made, geom=faces)
    new = [each for each in copies["geom"] if isinstance(each, bmesh.types.BMFace)]
    for vertex in {vertex for face in new for vertex in face.verts}:
        vertex.co -= gap * vertex.normal
    for face in new:
        face.material_index = behind[face.material_index]
    bmesh.ops.reverse_faces(made, faces=new)
    made.to_mesh(mesh)
    made.free()
