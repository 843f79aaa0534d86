# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Test objects that show a room's shadows and reflections, and where in a picture they can stand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from .cameras import camera_geometry
from .outliner import collection
from .placement import Cast, ViewGeometry, find_support
from .standing import INSERTED, Guest, Surface, find_surface, guest_of_made

# kind -> base colour, roughness, metallic
MATERIALS = {
    "grey_ball": ((0.18, 0.18, 0.18), 1.0, 0.0),
    "mirror_ball": ((0.95, 0.95, 0.95), 0.02, 1.0),
    "monkey": ((0.8, 0.25, 0.08), 0.25, 0.0),
}
_BALL_SHARE = 0.03  # a ball's diameter as a share of the room's diagonal
_BALL_SIZE = 0.2  # metres, without a room


def ball_size(room: Iterable[bpy.types.Object]) -> float:
    """Diameter in metres that suits a room of any scale."""
    corners = [item.matrix_world @ Vector(corner) for item in room for corner in item.bound_box]
    if not corners:
        return _BALL_SIZE
    points = np.array(corners)
    diagonal = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    return _BALL_SHARE * diagonal or _BALL_SIZE


def make_balls(
    scene: bpy.types.Scene, kinds: Iterable[str], size: float, across: Sequence[float] = (1.0, 0.0, 0.0)
) -> Guest:
    """Test objects ready to be placed; several stand side by side below one empty.

    Args:
        kinds: keys of `MATERIALS`.
        size: height of each, metres.
        across: direction of their row as it stands on a floor.

    Raises:
        FiptError: ``object-unknown``.
    """
    items = [_make(scene, kind, size) for kind in kinds]
    if len(items) == 1:
        return guest_of_made(items[0])
    root = bpy.data.objects.new("FIPT balls", None)
    root.empty_display_size = 0.25 * size
    collection(scene, INSERTED).objects.link(root)
    row = Vector((across[0], across[1], 0.0))
    row = row.normalized() if row.length > 1e-6 else Vector((1.0, 0.0, 0.0))
    for index, item in enumerate(items):
        item.parent = root
        item.location = 1.15 * size * (index - 0.5 * (len(items) - 1)) * row
    return guest_of_made(root)


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
    mesh = bpy.data.meshes.new(f"FIPT {kind}")
    bm.to_mesh(mesh)
    bm.free()
    mesh.materials.append(_material(kind))
    item = bpy.data.objects.new(mesh.name, mesh)
    collection(scene, INSERTED).objects.link(item)
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


def surface_at(scene: bpy.types.Scene, camera: bpy.types.Object, u: float, v: float) -> Surface:
    """The surface that a pixel position of a camera's picture shows.

    Args:
        u, v: pixels from the top left.

    Raises:
        FiptError: ``surface-missing`` or ``camera-kind``.
    """
    origin, direction = camera_geometry(scene, camera).ray(u, v)
    graph = bpy.context.evaluated_depsgraph_get()
    found = find_surface(scene, graph, Vector(origin), Vector(direction))
    if found is None:
        raise FiptError(
            "surface-missing", "There is no surface at that place.", "Choose a place where the room is seen."
        )
    return found


def free_spot(scene: bpy.types.Scene, camera: bpy.types.Object) -> Surface:
    """Where in a camera's picture something can stand: a free level spot, else any level surface.

    Raises:
        FiptError: ``surface-missing`` or ``camera-kind``.
    """
    view, cast = camera_geometry(scene, camera), _cast(scene)
    for share in (0.18, 0.1, 0.05):
        support = find_support(cast, view, share)
        if support is not None:
            return Surface(Vector(support.point), Vector((0.0, 0.0, 1.0)))
    return _lowest_level(cast, view)


def _lowest_level(cast: Cast, view: ViewGeometry) -> Surface:
    """The lowest surface of a grid of rays that looks upwards."""
    best: Surface | None = None
    for v in np.linspace(0.1, 0.9, 9):
        for u in (0.5, 0.375, 0.625, 0.25, 0.75):
            hit = cast(*view.ray(u * view.width, v * view.height))
            if hit is not None and hit[1][2] > 0.9 and (best is None or hit[0][2] < best.position.z - 0.01):
                best = Surface(Vector(hit[0]), Vector(hit[1]))
    if best is None:
        raise FiptError(
            "surface-missing", "The view shows no level surface.", "Choose a view that sees floor or a table."
        )
    return best


def _cast(scene: bpy.types.Scene) -> Cast:
    """Ray queries against what is visible."""
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def cast(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        start = origin + 1e-5 * max(1.0, float(np.abs(origin).max())) * direction
        found = find_surface(scene, depsgraph, Vector(start), Vector(direction))
        return None if found is None else (np.array(found.position), np.array(found.normal))

    return cast
