# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The irradiance at points of a scene, by Cycles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.errors import FiptError
from ..changed import changed
from ..node_trees import node_tree

_RADIUS = 1e-3  # of the triangles that receive the light, metres
_BAKE = {
    "use_denoising": False,
    "use_adaptive_sampling": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "max_bounces": 32,
    "diffuse_bounces": 32,
    "glossy_bounces": 32,
}


def irradiance(
    scene: bpy.types.Scene,
    points: Sequence[Sequence[float]] | np.ndarray,
    normals: Sequence[Sequence[float]] | np.ndarray,
    samples: int = 256,
    indirect: bool = False,
) -> np.ndarray:
    """(N,3) rgb W/m² of the light at points (N,3) of surfaces with normals (N,3).

    Args:
        scene: the window's.
        points, normals: world.
        samples: of each corner of a triangle at a point.
        indirect: whether light counts that other surfaces reflect.

    Raises:
        FiptError: ``engine-missing``.
    """
    if not hasattr(scene, "cycles"):
        raise FiptError("engine-missing", "Cycles is not enabled.", "Enable it in the preferences.")
    passes = {"DIRECT", "INDIRECT"} if indirect else {"DIRECT"}
    with _probe(scene, np.asarray(points), np.asarray(normals)) as mesh, ExitStack() as stack:
        stack.enter_context(changed(scene.render, {"engine": "CYCLES"}))
        stack.enter_context(changed(scene.cycles, {**_BAKE, "samples": samples}))
        bpy.ops.object.bake(type="DIFFUSE", pass_filter=passes, target="VERTEX_COLORS")
        values = np.empty(4 * len(mesh.loops), np.float32)
        mesh.color_attributes["Received"].data.foreach_get("color", values)
    return np.pi * values.reshape(-1, 3, 4)[..., :3].mean(axis=1).astype(np.float64)


@contextmanager
def _probe(scene: bpy.types.Scene, points: np.ndarray, normals: np.ndarray) -> Iterator[bpy.types.Mesh]:
    """For the length of a block, small white triangles at points, as the active object, alone selected."""
    corners = []
    for point, normal in zip(points.tolist(), normals.tolist(), strict=True):
        front = Vector(normal).normalized()
        across = front.orthogonal().normalized() * _RADIUS
        up = front.cross(across)
        corners += [Vector(point) + each for each in (across, up - 0.5 * across, -0.5 * across - up)]
    mesh = bpy.data.meshes.new("Probe")
    mesh.from_pydata(corners, [], np.arange(len(corners)).reshape(-1, 3).tolist())
    mesh.color_attributes.active_color = mesh.color_attributes.new("Received", "FLOAT_COLOR", "CORNER")
    item, material = bpy.data.objects.new("Probe", mesh), bpy.data.materials.new("Probe")
    nodes, links = node_tree(material).nodes, node_tree(material).links
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    layer = bpy.context.view_layer
    active, selected = layer.objects.active, [other for other in layer.objects if other.select_get()]
    scene.collection.objects.link(item)
    for other in selected:
        other.select_set(False)
    item.select_set(True)
    layer.objects.active = item
    try:
        yield mesh
    finally:
        bpy.data.batch_remove([item, mesh, material])
        for other in selected:
            other.select_set(True)
        layer.objects.active = active
