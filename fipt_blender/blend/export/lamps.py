# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps for other programs, whose surfaces have one emission for both sides."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np

from ..lights.convert import is_closed, vector_areas, world_triangles
from ..lights.fixture_nodes import is_emission_material, side_radiance
from .materials import glowing_material

# Metres between the front and the back of a lamp whose sides emit differently.
GAP = 5e-4
_BLACK = (0.0, 0.0, 0.0)


def plain_lamp(item: bpy.types.Object, lit: bool) -> list[tuple[bpy.types.Material, bpy.types.Material, str]]:
    """Give a copy of a fixture materials that emit alike on both sides.

    A lamp whose sides emit differently gets a second surface closely behind the first one. The inside of a
    closed lamp emits nothing, and no side does where the lamp is not `lit`.

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
        front, back = side_radiance(material) if lit else (_BLACK, _BLACK)
        alike = np.allclose(front, back, rtol=1e-3)
        made.append((glowing_material(material.name, front, not alike), material, ""))
        slot.material = made[-1][0]
        if not alike and not closed:
            made.append((glowing_material(material.name, back, True), material, " Back"))
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
