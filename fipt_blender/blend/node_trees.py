"""Node trees of materials and worlds in every supported version of Blender."""

from __future__ import annotations

from typing import Any, TypeAlias

import bpy

_Value: TypeAlias = bpy.types.NodeSocket | float | tuple[float, ...]


def node_tree(owner: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The node tree of a material or world; up to Blender 4.5 it exists only once nodes are used."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree


class TreeBuilder:
    """Adds nodes to a tree by what they compute; values are sockets or constants."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        self.column = 0

    def node(self, kind: str, **properties: Any) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        node.location = (180.0 * self.column, -60.0 * (self.column % 5))
        self.column += 1
        return node

    def feed(self, socket: bpy.types.NodeSocket, value: _Value) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *values: _Value, clamp: bool = False) -> bpy.types.NodeSocket:
        node = self.node("ShaderNodeMath", operation=operation, use_clamp=clamp)
        for socket, value in zip(node.inputs, values, strict=False):
            self.feed(socket, value)
        return node.outputs["Value"]

    def vector(self, operation: str, result: str, **values: _Value) -> bpy.types.NodeSocket:
        node = self.node("ShaderNodeVectorMath", operation=operation)
        for name, value in values.items():
            index = {"a": 0, "b": 1, "c": 2}.get(name)
            self.feed(node.inputs["Scale"] if index is None else node.inputs[index], value)
        return node.outputs[result]

    def lookup(self, image: bpy.types.Image, uv: bpy.types.NodeSocket) -> list[bpy.types.NodeSocket]:
        node = self.node("ShaderNodeTexImage", image=image, interpolation="Linear", extension="EXTEND")
        self.feed(node.inputs["Vector"], uv)
        parts = self.node("ShaderNodeSeparateXYZ")
        self.feed(parts.inputs["Vector"], node.outputs["Color"])
        return list(parts.outputs)
