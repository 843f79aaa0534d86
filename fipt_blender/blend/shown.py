"""Switches a material between its own surface and one of its maps, shown as emission in any engine."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from .marks import OUTPUT, SURFACE, remove_marks

SHOWN = "FIPT Shown"
UNCHANGED = ("ESTIMATED", "ORIGINAL")  # what is shown of a material other than a map


def write_surface(
    material: bpy.types.Material, shown: str, source: bpy.types.NodeSocket | None, constant: Sequence[float]
) -> None:
    """Let one of our materials show itself or a map.

    Args:
        material: its output node is "FIPT Output"; nothing happens without it.
        shown: one of `UNCHANGED` for the material itself, otherwise a map.
        source: the output whose colour is the map; None for a constant.
        constant: rgba of a map without a source.
    """
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = nodes.get(OUTPUT)
    if output is None:
        return
    surface, node = output.inputs["Surface"], nodes.get(SHOWN)
    if shown in UNCHANGED:
        if node is None:
            return
        name, _, socket = material.get(SURFACE, "").partition("\n")
        original = nodes.get(name)
        nodes.remove(node)
        if original is not None and socket in original.outputs:
            links.new(original.outputs[socket], surface)
        remove_marks(material, SURFACE)
        return
    if node is None:
        if surface.is_linked:
            link = surface.links[0]
            material[SURFACE] = f"{link.from_node.name}\n{link.from_socket.name}"
        node = nodes.new("ShaderNodeEmission")
        node.name, node.label = SHOWN, "Map shown in place of the material"
        node.location = (output.location.x - 200.0, output.location.y + 140.0)
        links.new(node.outputs["Emission"], surface)
    color = node.inputs["Color"]
    for link in list(color.links):
        links.remove(link)
    node.inputs["Strength"].default_value = 1.0
    color.default_value = constant
    if source is not None:
        links.new(source, color)
