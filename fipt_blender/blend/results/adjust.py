# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's corrections on top of an estimate: a node group between a part's textures and its shader.

All materials of a part have the same values, in the inputs of their nodes. `adjusted` has the same formulas
for arrays.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import bpy
import numpy as np

from ..marks import ADJUSTMENT, MAP
from ..node_trees import node_tree

GROUP = "FIPT Adjust"
MAPS = ("Base Color", "Roughness", "Metallic")
_VERSION = 2  # of the node group; those of earlier ones are replaced when a value is written


@dataclass(frozen=True)
class Adjustment:
    """Changes to a part's estimate; the defaults change nothing.

    Attributes:
        roughness, metallic: added, -1 to 1; the sum is clamped to 0 to 1.
        hue: turn of the base colour's hue, -0.5 to 0.5 of the circle.
        saturation, value: factors of the base colour's saturation and value, 0 to 2.
        gain, red, green, blue: factor of the base colour and what is then added, scene-linear, before these.
    """

    roughness: float = 0.0
    metallic: float = 0.0
    hue: float = 0.0
    saturation: float = 1.0
    value: float = 1.0
    gain: float = 1.0
    red: float = 0.0
    green: float = 0.0
    blue: float = 0.0


NO_ADJUSTMENT = Adjustment()
# Inputs of the group: name, range.
_INPUTS = {
    "roughness": ("Roughness Offset", -1.0, 1.0),
    "metallic": ("Metallic Offset", -1.0, 1.0),
    "hue": ("Hue", -0.5, 0.5),
    "saturation": ("Saturation", 0.0, 2.0),
    "value": ("Value", 0.0, 2.0),
    "gain": ("Gain", 0.0, 4.0),
    "red": ("Red", -4.0, 4.0),
    "green": ("Green", -4.0, 4.0),
    "blue": ("Blue", -4.0, 4.0),
}
_SHIFT = ("red", "green", "blue")


def add_adjustment(material: bpy.types.Material, values: Adjustment) -> bpy.types.Node:
    """Put the group behind the map nodes of an estimated material."""
    tree = node_tree(material)
    node = tree.nodes.new("ShaderNodeGroup")
    node.name = GROUP
    node.label = "Adjust the estimate"
    node.node_tree = _group()
    node.width = 180.0
    for label in MAPS:
        tree.links.new(tree.nodes[MAP.format(label)].outputs["Color"], node.inputs[label])
    write(material, values)
    return node


def output(material: bpy.types.Material, label: str) -> bpy.types.NodeSocket | None:
    """The adjusted value of a map; of other maps the map itself, None where the material lacks it."""
    nodes = node_tree(material).nodes
    node = nodes.get(GROUP)
    if node is not None and label in node.outputs:
        return node.outputs[label]
    node = nodes.get(MAP.format(label))
    return None if node is None else node.outputs["Color"]


def read(material: bpy.types.Material) -> Adjustment:
    """The adjustment of a material; none where it has no group."""
    node = node_tree(material).nodes.get(GROUP)
    if node is None:
        return NO_ADJUSTMENT
    values = {
        key: float(node.inputs[name].default_value)
        for key, (name, _, _) in _INPUTS.items()
        if name in node.inputs
    }
    return Adjustment(**values)


def write(material: bpy.types.Material, values: Adjustment) -> None:
    """Set the adjustment of a material; nothing happens where it has no group."""
    node = node_tree(material).nodes.get(GROUP)
    if node is not None and values != NO_ADJUSTMENT and node.node_tree.get(ADJUSTMENT) != _VERSION:
        node.node_tree = _group()  # the sockets that it had keep their links and values
    for field, value in zip(fields(Adjustment), astuple(values), strict=True):
        name = _INPUTS[field.name][0]
        if node is not None and name in node.inputs:
            node.inputs[name].default_value = value


def adjusted(values: Adjustment, maps: np.ndarray) -> np.ndarray:
    """What the group makes of base colour, roughness and metallic.

    Args:
        values: the adjustment.
        maps: (N, 5), linear base colour in the first three columns.

    Returns:
        (N, 5) of the same type.
    """
    if values == NO_ADJUSTMENT:
        return maps
    result = np.empty_like(maps)
    moved = maps[:, :3].astype(np.float64) * values.gain + [getattr(values, name) for name in _SHIFT]
    result[:, :3] = _shifted(np.maximum(moved, 0.0), values)
    result[:, 3:] = np.clip(maps[:, 3:] + np.array([values.roughness, values.metallic]), 0.0, 1.0)
    return result


def _shifted(color: np.ndarray, values: Adjustment) -> np.ndarray:
    """Colours (N, 3) with another hue, saturation and value, as the node Hue/Saturation/Value."""
    high, low = color.max(axis=1), color.min(axis=1)
    spread = high - low
    safe = np.where(spread > 0.0, spread, 1.0)
    red, green, blue = (color / safe[:, None]).T
    hue = np.select(
        [high == color[:, 0], high == color[:, 1]], [green - blue, 2.0 + blue - red], 4.0 + red - green
    )
    hue = np.where(spread > 0.0, hue, 0.0) / 6.0 + values.hue
    saturation = np.where(high > 0.0, spread / np.where(high > 0.0, high, 1.0), 0.0)
    saturation = np.clip(saturation * values.saturation, 0.0, 1.0)
    ramps = np.abs((hue[:, None] + np.array([0.0, 2.0, 1.0]) / 3.0) % 1.0 * 6.0 - 3.0) - 1.0
    full = np.clip(ramps, 0.0, 1.0)
    shifted = (high * values.value)[:, None] * (1.0 - saturation[:, None] * (1.0 - full))
    return np.clip(shifted, 0.0, 1.0)


def is_adjustment(tree: bpy.types.NodeTree) -> bool:
    """Whether a node group is this module's."""
    return ADJUSTMENT in tree


def _group() -> bpy.types.NodeTree:
    """The file's group, made where there is none of this version."""
    for tree in bpy.data.node_groups:
        if tree.get(ADJUSTMENT) == _VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    tree[ADJUSTMENT] = _VERSION
    for label in MAPS:
        kind = "NodeSocketColor" if label == "Base Color" else "NodeSocketFloat"
        tree.interface.new_socket(label, in_out="OUTPUT", socket_type=kind)
        tree.interface.new_socket(label, in_out="INPUT", socket_type=kind)
    for key, (name, low, high) in _INPUTS.items():
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.min_value, socket.max_value = low, high
        socket.default_value = getattr(NO_ADJUSTMENT, key)
    _fill(tree)
    return tree


def _fill(tree: bpy.types.NodeTree) -> None:
    nodes, links = tree.nodes, tree.links
    entry, result = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    entry.location, result.location = (-1000.0, 0.0), (400.0, 0.0)
    turn = _math(tree, "ADD", entry.outputs["Hue"], 0.5, -400.0, 240.0)  # 0.5 leaves the hue as it is
    color = nodes.new("ShaderNodeHueSaturation")
    color.location = (-200.0, 240.0)
    links.new(turn, color.inputs["Hue"])
    for name in ("Saturation", "Value"):
        links.new(entry.outputs[name], color.inputs[name])
    links.new(_moved(tree, entry), color.inputs["Color"])
    most = nodes.new("ShaderNodeVectorMath")  # a surface reflects no more light than it gets
    most.operation, most.location = "MINIMUM", (0.0, 240.0)
    links.new(color.outputs["Color"], most.inputs[0])
    most.inputs[1].default_value = (1.0, 1.0, 1.0)
    links.new(most.outputs["Vector"], result.inputs["Base Color"])
    for row, label in enumerate(MAPS[1:]):
        offset = entry.outputs[f"{label} Offset"]
        links.new(
            _math(tree, "ADD", entry.outputs[label], offset, -200.0, -200.0 * row), result.inputs[label]
        )


def _moved(tree: bpy.types.NodeTree, entry: bpy.types.Node) -> bpy.types.NodeSocket:
    """The base colour with gain and shift, not below 0."""
    shift = tree.nodes.new("ShaderNodeCombineXYZ")
    shift.location = (-800.0, 60.0)
    for name, socket in zip(_SHIFT, shift.inputs, strict=True):
        tree.links.new(entry.outputs[_INPUTS[name][0]], socket)
    moved, least = (tree.nodes.new("ShaderNodeVectorMath") for _ in range(2))
    moved.operation, moved.location = "MULTIPLY_ADD", (-600.0, 240.0)
    for socket, source in zip(
        moved.inputs, (entry.outputs["Base Color"], entry.outputs["Gain"], shift.outputs[0]), strict=False
    ):
        tree.links.new(source, socket)
    least.operation, least.location = "MAXIMUM", (-400.0, 60.0)
    tree.links.new(moved.outputs["Vector"], least.inputs[0])
    least.inputs[1].default_value = (0.0, 0.0, 0.0)
    return least.outputs["Vector"]


def _math(
    tree: bpy.types.NodeTree,
    operation: str,
    first: bpy.types.NodeSocket,
    second: bpy.types.NodeSocket | float,
    x: float,
    y: float,
) -> bpy.types.NodeSocket:
    """A clamped sum or product."""
    node = tree.nodes.new("ShaderNodeMath")
    node.operation, node.use_clamp, node.location = operation, True, (x, y)
    tree.links.new(first, node.inputs[0])
    if isinstance(second, bpy.types.NodeSocket):
        tree.links.new(second, node.inputs[1])
    else:
        node.inputs[1].default_value = second
    return node.outputs["Value"]
