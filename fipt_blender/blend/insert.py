# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Test objects that stand on the room's surfaces, to see shadows and reflections."""

from __future__ import annotations

import bmesh
import bpy
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from .outliner import collection

INSERTED = "FIPT Inserted"
# kind -> base colour, roughness, metallic
MATERIALS = {
    "grey_ball": ((0.18, 0.18, 0.18), 1.0, 0.0),
    "mirror_ball": ((0.95, 0.95, 0.95), 0.02, 1.0),
    "monkey": ((0.8, 0.25, 0.08), 0.25, 0.0),
}


def surface_under(scene: bpy.types.Scene, origin: Vector, direction: Vector) -> tuple[Vector, Vector]:
    """First surface that a ray meets: position and unit normal on the ray's side, in the world.

    Raises:
        FiptError: ``surface-missing``.
    """
    hit, position, normal, *_ = scene.ray_cast(
        bpy.context.evaluated_depsgraph_get(), origin, direction.normalized()
    )
    if not hit:
        raise FiptError(
            "surface-missing", "There is no surface at that place.", "Choose a place where the room is seen."
        )
    return position, -normal if normal.dot(direction) > 0.0 else normal


def find_floor(scene: bpy.types.Scene, camera: bpy.types.Object) -> tuple[Vector, Vector]:
    """A level surface in the picture of a camera: the lowest of a grid of rays that looks upwards.

    Raises:
        FiptError: ``surface-missing`` where no level surface is in view.
    """
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    top_right, bottom_right, bottom_left, top_left = corners
    origin = camera.matrix_world.translation
    best: tuple[Vector, Vector] | None = None
    for row in range(1, 9):
        for column in (4, 3, 5, 2, 6):
            left = top_left.lerp(bottom_left, row / 9.0)
            right = top_right.lerp(bottom_right, row / 9.0)
            try:
                position, normal = surface_under(scene, origin, left.lerp(right, column / 8.0) - origin)
            except FiptError:
                continue
            if normal.z > 0.9 and (best is None or position.z < best[0].z - 0.01):
                best = position, normal
    if best is None:
        raise FiptError(
            "surface-missing", "The view shows no level surface.", "Choose a view that sees floor or table."
        )
    return best


def insert_object(
    scene: bpy.types.Scene,
    location: Vector,
    normal: Vector | None = None,
    kind: str = "monkey",
    size: float = 0.3,
) -> bpy.types.Object:
    """Stand a test object on a surface.

    Args:
        location: point of the surface, world.
        normal: unit normal there, which becomes the object's up; straight up by default.
        kind: a key of `MATERIALS`.
        size: height in metres.
    """
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
    mesh = bpy.data.meshes.new(f"FIPT {kind}")
    bm.to_mesh(mesh)
    bm.free()
    mesh.materials.append(_material(kind))
    item = bpy.data.objects.new(mesh.name, mesh)
    collection(scene, INSERTED).objects.link(item)
    up = Vector((0.0, 0.0, 1.0)) if normal is None else normal
    item.matrix_world = Matrix.Translation(location) @ up.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return item


def _material(kind: str) -> bpy.types.Material:
    name = f"FIPT {kind}"
    material = bpy.data.materials.get(name) or bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    principled = next(
        node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"
    )
    color, roughness, metallic = MATERIALS[kind]
    principled.inputs["Base Color"].default_value = (*color, 1.0)
    principled.inputs["Roughness"].default_value = roughness
    principled.inputs["Metallic"].default_value = metallic
    return material
