"""The artist's corrections on top of an estimate: a node group between a part's textures and its shader.

All materials of a part have the same values, in the inputs of their nodes. `adjusted` has the same formulas
for arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..marks import ADJUSTMENT, MAP
from ..node_trees import TreeBuilder, node_tree

GROUP = "FIPT Adjust"
MAPS = ("Base Color", "Roughness", "Metallic")


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
    return Adjustment(**{key: node.inputs[name].default_value for key, (name, _, _) in _INPUTS.items()})


def write(material: bpy.types.Material, values: Adjustment) -> None:
    """Set the adjustment of a material; nothing happens where it has no group."""
    node = node_tree(material).nodes.get(GROUP)
    for key, (name, _, _) in _INPUTS.items() if node is not None else ():
        node.inputs[name].default_value = getattr(values, key)


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
    """The file's group, made where there is none."""
    for tree in bpy.data.node_groups:
        if is_adjustment(tree) and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    tree[ADJUSTMENT] = True
    for label in MAPS:
        kind = "NodeSocketColor" if label == "Base Color" else "NodeSocketFloat"
        tree.interface.new_socket(label, in_out="OUTPUT", socket_type=kind)
        tree.interface.new_socket(label, in_out="INPUT", socket_type=kind)
    for key, (name, low, high) in _INPUTS.items():
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.min_value, socket.max_value = low, high
        socket.default_value = getattr(NO_ADJUSTMENT, key)
    _fill(TreeBuilder(tree))
    return tree


def _fill(build: TreeBuilder) -> None:
    entry = build.node("NodeGroupInput").outputs
    shift = build.node("ShaderNodeCombineXYZ")
    for key, socket in zip(_SHIFT, shift.inputs, strict=True):
        build.feed(socket, entry[_INPUTS[key][0]])
    gain, base_color = entry["Gain"], entry["Base Color"]
    moved = build.vector("MULTIPLY_ADD", "Vector", a=base_color, b=gain, c=shift.outputs["Vector"])
    color = build.node("ShaderNodeHueSaturation")
    build.feed(color.inputs["Hue"], build.math("ADD", entry["Hue"], 0.5, clamp=True))  # 0.5: as it is
    for name in ("Saturation", "Value"):
        build.feed(color.inputs[name], entry[name])
    build.feed(color.inputs["Color"], build.vector("MAXIMUM", "Vector", a=moved, b=(0.0, 0.0, 0.0)))
    # A surface reflects no more light than it gets.
    most = build.vector("MINIMUM", "Vector", a=color.outputs["Color"], b=(1.0, 1.0, 1.0))
    offset = [build.math("ADD", entry[label], entry[f"{label} Offset"], clamp=True) for label in MAPS[1:]]
    result = build.node("NodeGroupOutput").inputs
    for label, value in zip(MAPS, (most, *offset), strict=True):
        build.feed(result[label], value)
