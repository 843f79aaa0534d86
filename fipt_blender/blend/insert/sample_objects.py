# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Test objects that show a room's shadows and reflections."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.errors import FiptError
from ..color_spaces import to_scene_linear
from ..node_trees import node_tree
from ..outliner import INSERTED, collection
from ..room.mesh_arrays import world_bounds
from .placing import Placement, begin_placing_made

# kind -> base colour (linear Rec.709), roughness, metallic
MATERIALS = {
    "gray_ball": ((0.18, 0.18, 0.18), 1.0, 0.0),
    "mirror_ball": ((0.95, 0.95, 0.95), 0.02, 1.0),
    "monkey": ((0.8, 0.25, 0.08), 0.25, 0.0),
}


def ball_size(room: Iterable[bpy.types.Object]) -> float:
    """Diameter in metres that suits a room of any scale."""
    bounds = world_bounds(room)
    if bounds is None:
        return 0.2  # metres, without a room
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
    return 0.03 * diagonal or 0.2  # of the room's diagonal


def make_balls(
    scene: bpy.types.Scene, kinds: Iterable[str], size: float, across: Sequence[float] = (1.0, 0.0, 0.0)
) -> Placement:
    """Make test objects and begin to place them; several stand in a row, as children of an empty.

    Args:
        scene: the scene to add them to.
        kinds: keys of `MATERIALS`.
        size: height of each, metres.
        across: horizontal direction of the row.

    Raises:
        FiptError: ``object-unknown``.
    """
    items = [_make(scene, kind, size) for kind in kinds]
    if len(items) == 1:
        return begin_placing_made(items[0])
    root = bpy.data.objects.new("FIPT balls", None)
    root.empty_display_size = 0.25 * size
    collection(scene, INSERTED).objects.link(root)
    row = Vector((across[0], across[1], 0.0))
    row = row.normalized() if row.length > 1e-6 else Vector((1.0, 0.0, 0.0))
    for index, item in enumerate(items):
        item.parent = root
        item.location = 1.15 * size * (index - 0.5 * (len(items) - 1)) * row
    return begin_placing_made(root)


def insert_object(
    scene: bpy.types.Scene,
    location: Vector,
    normal: Vector | None = None,
    kind: str = "monkey",
    size: float = 0.3,
) -> bpy.types.Object:
    """Make a test object that stands on a surface.

    Args:
        scene: the scene to add it to.
        location: point of the surface, world.
        normal: unit normal there, which becomes the object's up axis; straight up by default.
        kind: a key of `MATERIALS`.
        size: height in metres.

    Raises:
        FiptError: ``object-unknown``.
    """
    item = _make(scene, kind, size)
    up = Vector((0.0, 0.0, 1.0)) if normal is None else normal
    item.matrix_world = Matrix.Translation(location) @ up.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return item


def _make(scene: bpy.types.Scene, kind: str, size: float) -> bpy.types.Object:
    if kind not in MATERIALS:
        raise FiptError(
            "object-unknown", f"There is no test object '{kind}'.", f"Use {', '.join(MATERIALS)}."
        )
    bm = bmesh.new()
    if kind == "monkey":
        bmesh.ops.create_monkey(bm)
        bmesh.ops.subdivide_edges(bm, edges=bm.edges, cuts=1, smooth=1.0, use_grid_fill=True)
    else:
        bmesh.ops.create_uvsphere(bm, u_segments=64, v_segments=32, radius=1.0)
    low = min(vertex.co.z for vertex in bm.verts)
    scale = size / (max(vertex.co.z for vertex in bm.verts) - low)
    bmesh.ops.transform(
        bm, verts=bm.verts, matrix=Matrix.Scale(scale, 4) @ Matrix.Translation((0.0, 0.0, -low))
    )
    for face in bm.faces:
        face.smooth = True
    mesh = bpy.data.meshes.new(_name(kind))
    bm.to_mesh(mesh)
    bm.free()
    mesh.materials.append(_material(kind))
    item = bpy.data.objects.new(mesh.name, mesh)
    collection(scene, INSERTED).objects.link(item)
    return item


def _name(kind: str) -> str:
    return f"FIPT {kind.replace('_', ' ').title()}"


def _material(kind: str) -> bpy.types.Material:
    name = _name(kind)
    material = bpy.data.materials.get(name) or bpy.data.materials.new(name)
    nodes = node_tree(material).nodes
    principled = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    color, roughness, metallic = MATERIALS[kind]
    principled.inputs["Base Color"].default_value = (*to_scene_linear(color), 1.0)
    principled.inputs["Roughness"].default_value = roughness
    principled.inputs["Metallic"].default_value = metallic
    return material
