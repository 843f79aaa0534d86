# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The irradiance at points of a scene, by Cycles."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from fipt_blender.blend.node_trees import node_tree

RADIUS = 1e-3  # of the triangles that receive the light, metres


def irradiance(
    scene: bpy.types.Scene, points: np.ndarray, normals: np.ndarray, samples: int = 256
) -> np.ndarray:
    """(N,3) rgb W/m² of direct light at points (N,3) of surfaces with normals (N,3); the window's scene."""
    corners = []
    for point, normal in zip(points.tolist(), normals.tolist(), strict=True):
        front = Vector(normal).normalized()
        across = front.orthogonal().normalized() * RADIUS
        up = front.cross(across)
        corners += [
            Vector(point) + across,
            Vector(point) - 0.5 * across + up,
            Vector(point) - 0.5 * across - up,
        ]
    mesh = bpy.data.meshes.new("Probe")
    mesh.from_pydata(corners, [], np.arange(len(corners)).reshape(-1, 3).tolist())
    received = mesh.color_attributes.new("Received", "FLOAT_COLOR", "CORNER")
    mesh.color_attributes.active_color = received
    item = bpy.data.objects.new("Probe", mesh)
    scene.collection.objects.link(item)
    material = bpy.data.materials.new("Probe")
    nodes, links = node_tree(material).nodes, node_tree(material).links
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = (
        samples,
        False,
        False,
    )
    scene.cycles.sample_clamp_direct = 0.0
    for other in scene.view_layers[0].objects:
        other.select_set(False)
    item.select_set(True)
    scene.view_layers[0].objects.active = item
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT"}, target="VERTEX_COLORS")
    values = np.empty(4 * len(corners), np.float32)
    mesh.color_attributes["Received"].data.foreach_get("color", values)
    bpy.data.objects.remove(item)
    bpy.data.meshes.remove(mesh)
    bpy.data.materials.remove(material)
    return np.pi * values.reshape(-1, 3, 4)[..., :3].mean(axis=1).astype(np.float64)
