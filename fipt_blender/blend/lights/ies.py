"""An IES profile on a Blender light: its file goes into an IES Texture node, which only Cycles renders."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.run.errors import FiptError

_NODE = "FIPT IES Profile"


def set_profile(light: bpy.types.Object, path: Path) -> None:
    """Let a Blender light send its light as a luminaire does, along its -Z axis.

    The light becomes a point, for which such tables are measured. The profile's candelas multiply its power.
    The file's content is stored in the .blend file.

    Args:
        light: an area, point or spot light.
        path: of an .ies file.
    """
    if not path.is_file():
        raise FiptError("ies-unreadable", path=path)
    if light.data.type != "POINT":
        size = getattr(light.data, "shadow_soft_size", 0.5 * getattr(light.data, "size", 0.1))
        light.data.type = "POINT"
        light.data.shadow_soft_size = min(size, 0.05)
    if hasattr(light.data, "use_nodes"):  # always on from Blender 5.0
        light.data.use_nodes = True
    nodes, links = light.data.node_tree.nodes, light.data.node_tree.links
    node = nodes.get(_NODE) or nodes.new("ShaderNodeTexIES")
    node.name, node.location = _NODE, (-240, 0)
    node.mode, node.ies = "INTERNAL", bpy.data.texts.load(str(path), internal=True)
    links.new(node.outputs["Fac"], _emission(light).inputs["Strength"])


def _emission(light: bpy.types.Object) -> bpy.types.Node:
    nodes, links = light.data.node_tree.nodes, light.data.node_tree.links
    found = next((node for node in nodes if node.type == "EMISSION"), None)
    if found is None:
        found = nodes.new("ShaderNodeEmission")
        output = next((node for node in nodes if node.type == "OUTPUT_LIGHT"), None)
        output = output or nodes.new("ShaderNodeOutputLight")
        links.new(found.outputs["Emission"], output.inputs["Surface"])
    return found
