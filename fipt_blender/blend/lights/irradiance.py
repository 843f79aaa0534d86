"""The irradiance at a point of a scene, by Cycles."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector

from ...core.run.errors import FiptError
from ..changed import changed
from ..node_trees import node_tree

_RADIUS = 1e-3  # of the triangle that receives the light, metres
_CORNERS = ((1.0, 0.0, 0.0), (-0.5, 1.0, 0.0), (-0.5, -1.0, 0.0))  # counter-clockwise seen from above
_BAKE = {
    "use_denoising": False,
    "use_adaptive_sampling": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "max_bounces": 32,
    "diffuse_bounces": 32,
    "glossy_bounces": 32,
}


def irradiance(scene: bpy.types.Scene, point: Sequence[float], samples: int = 256) -> np.ndarray:
    """(3,) rgb W/m² of the light that a horizontal surface at a point of the world gets from above.

    Args:
        scene: the window's.
        point: world.
        samples: of each corner of a small white triangle there.
    """
    if not hasattr(scene, "cycles"):
        raise FiptError("engine-missing.irradiance")
    mesh, material = bpy.data.meshes.new("Probe"), bpy.data.materials.new("Probe")
    mesh.from_pydata([Vector(point) + _RADIUS * Vector(corner) for corner in _CORNERS], [], [(0, 1, 2)])
    mesh.color_attributes.active_color = mesh.color_attributes.new("Received", "FLOAT_COLOR", "CORNER")
    nodes, links = node_tree(material).nodes, node_tree(material).links
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    item = bpy.data.objects.new("Probe", mesh)
    scene.collection.objects.link(item)
    alone = {"object": item, "active_object": item, "selected_objects": [item]}
    try:
        with (
            changed(scene.render, {"engine": "CYCLES"}),
            changed(scene.cycles, {**_BAKE, "samples": samples}),
            bpy.context.temp_override(**alone),
        ):
            bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
        values = np.empty(4 * len(mesh.loops), np.float32)
        mesh.color_attributes["Received"].data.foreach_get("color", values)
    finally:
        bpy.data.batch_remove([item, mesh, material])
    return np.asarray(np.pi * values.reshape(3, 4)[:, :3].mean(axis=0, dtype=np.float64))
