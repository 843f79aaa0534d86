# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One material between its own surface and a map of it, which it then sends out as light in any engine."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

SURFACE = "fipt_surface"  # what fed the output before a map did: node and socket, a line each
OUTPUT, SHOWN = "FIPT Output", "FIPT Shown"


def write_surface(
    material: bpy.types.Material, shown: str, source: bpy.types.Node | None, constant: Sequence[float]
) -> None:
    """Let a material of ours show itself or a map.

    Args:
        material: with an output node "FIPT Output"; without one nothing happens.
        shown: "ESTIMATED" or "ORIGINAL" for the material itself, else a map.
        source: the node whose colour is the map; None for a constant.
        constant: rgba where there is no source.
    """
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = nodes.get(OUTPUT)
    if output is None:
        return
    surface, node = output.inputs["Surface"], nodes.get(SHOWN)
    if shown in ("ESTIMATED", "ORIGINAL"):
        if node is None:
            return
        name, _, socket = material.get(SURFACE, "").partition("\n")
        before = nodes.get(name)
        nodes.remove(node)
        if before is not None and socket in before.outputs:
            links.new(before.outputs[socket], surface)
        material.pop(SURFACE, None)
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
        links.new(source.outputs["Color"], color)
