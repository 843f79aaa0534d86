"""Balls that show a room's light: a gray one its shadows, a mirror ball its surroundings."""

from __future__ import annotations

from collections.abc import Iterable

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..color_spaces import to_scene_linear
from ..node_trees import node_tree
from ..outliner import INSERTED, collection
from ..room.mesh_arrays import world_bounds

# kind -> base colour (linear Rec.709), roughness, metallic
MATERIALS = {
    "gray_ball": ((0.18, 0.18, 0.18), 1.0, 0.0),
    "mirror_ball": ((0.95, 0.95, 0.95), 0.02, 1.0),
}


def ball_size(room: Iterable[bpy.types.Object]) -> float:
    """Diameter in metres that suits a room of any scale."""
    bounds = world_bounds(room)
    if bounds is None:
        return 0.2  # metres, without a room
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
    return 0.03 * diagonal or 0.2  # of the room's diagonal


def add_ball(scene: bpy.types.Scene, location: Vector, kind: str, size: float) -> bpy.types.Object:
    """Make a ball that stands on a point of a level surface.

    Args:
        scene: the scene to add it to.
        location: the point, in the world.
        kind: a key of `MATERIALS`.
        size: diameter in metres.
    """
    bm = bmesh.new()
    bmesh.ops.create_uvsphere(bm, u_segments=64, v_segments=32, radius=0.5 * size)
    bmesh.ops.translate(bm, verts=bm.verts, vec=(0.0, 0.0, 0.5 * size))
    for face in bm.faces:
        face.smooth = True
    mesh = bpy.data.meshes.new(_name(kind))
    bm.to_mesh(mesh)
    bm.free()
    mesh.materials.append(_material(kind))
    item = bpy.data.objects.new(mesh.name, mesh)
    item.matrix_world = Matrix.Translation(location)
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
