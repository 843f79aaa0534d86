# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Result meshes of a scan get the cleaned vertices and normals on which the estimation has worked."""

from __future__ import annotations

import bpy
import numpy as np

from .arrays import Room
from .mesh_arrays import corner_vertices, is_mirrored, transform_points, triangle_loops, vertex_positions


def clean_result_mesh(
    mesh: bpy.types.Mesh,
    item: bpy.types.Object,
    room: Room,
    index: int,
    geometry: dict[str, np.ndarray],
) -> None:
    """Move the vertices of a result mesh to those of the cleaned scan, and set its shading normals.

    Args:
        mesh: the new result mesh of `item`, with the triangles that were exported.
        item: the object; it is not changed.
        room, index: the run's room, and the object's index in it.
        geometry: content of geometry.npz.
    """
    of_object = room.triangle_object == index
    loops, _ = triangle_loops(mesh, is_mirrored(item))
    matrix = np.array(item.matrix_world, np.float64)
    positions = vertex_positions(mesh)
    corners = geometry["vertices"][room.triangles[of_object].ravel()].astype(np.float64)
    positions[corner_vertices(mesh)[loops.ravel()]] = transform_points(corners, np.linalg.inv(matrix))
    mesh.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    # Normals transform by the inverse transpose, back by the transpose.
    local = geometry["corner_normals"][of_object].reshape(-1, 3).astype(np.float64) @ matrix[:3, :3]
    normals = np.zeros((len(mesh.loops), 3))
    normals[loops.ravel()] = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    mesh.shade_smooth()
    mesh.normals_split_custom_set(normals)
    mesh.update()
