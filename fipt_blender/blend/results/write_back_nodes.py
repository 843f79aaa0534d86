"""A node group between Principled and the output that makes Cycles agree with the fitted model.

The formulas are those of `core.textures.write_back`. The textures stay connected to Principled, so
that exporters find them; muting the group leaves plain Principled.
"""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

from ...core.optics.factorised import DIELECTRIC_REFLECTANCE
from ...core.textures import write_back
from ..color_spaces import from_scene_linear
from ..marks import OUTPUT, PRINCIPLED, TABLE
from ..node_trees import TreeBuilder

GROUP = "FIPT Agreement"
_LABELS = ("Base Color", "Roughness", "Metallic")


def agree_with_model(material: bpy.types.Material, masking: str = write_back.MASKINGS[0]) -> None:
    """Put the group between Principled and the output of an estimated material.

    Args:
        material: made by `results.materials`.
        masking: the masking term G of the fitted model, as in the run's settings.
    """
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled, output = nodes[PRINCIPLED], nodes[OUTPUT]
    node = nodes.new("ShaderNodeGroup")
    node.name = GROUP
    node.label = "Makes Cycles agree with the estimate"
    node.node_tree = agreement_group(masking)
    node.width = 200.0
    node.location = (principled.location.x + 320.0, principled.location.y)
    output.location = (node.location.x + 260.0, principled.location.y)
    for label in _LABELS:
        links.new(principled.inputs[label].links[0].from_socket, node.inputs[label])
    links.new(principled.outputs["BSDF"], node.inputs["BSDF"])
    links.new(node.outputs["BSDF"], output.inputs["Surface"])


def agreement_group(masking: str = write_back.MASKINGS[0]) -> bpy.types.NodeTree:
    """The file's group for a masking term; made where the file has none of the current version."""
    values = write_back.table(masking).astype(np.float32)
    weights = from_scene_linear(np.eye(3)).mean(axis=1)  # of a scene-linear colour in the mean of Rec.709's
    digest = hashlib.sha256(values.tobytes() + weights.tobytes()).hexdigest()[:16]
    for tree in bpy.data.node_groups:
        if tree.get(TABLE) == digest:
            return tree
    tree = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    tree[TABLE] = digest
    _fill(TreeBuilder(tree), values, tuple(weights.tolist()))
    return tree


def _table_image(name: str, values: np.ndarray) -> bpy.types.Image:
    """A packed float image of (rows, columns, 3) values, row 0 at the bottom."""
    rows, columns, _ = values.shape
    image = bpy.data.images.new(name, columns, rows, alpha=False, float_buffer=True, is_data=True)
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = values
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def _fill(build: TreeBuilder, values: np.ndarray, weights: tuple[float, ...]) -> None:
    """The nodes of the group."""
    interface = build.tree.interface
    interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    interface.new_socket("BSDF", in_out="INPUT", socket_type="NodeSocketShader")
    interface.new_socket("Base Color", in_out="INPUT", socket_type="NodeSocketColor")
    interface.new_socket("Roughness", in_out="INPUT", socket_type="NodeSocketFloat")
    interface.new_socket("Metallic", in_out="INPUT", socket_type="NodeSocketFloat")
    inputs = build.node("NodeGroupInput").outputs
    base_color, roughness, metallic = (inputs[label] for label in _LABELS)

    geometry = build.node("ShaderNodeNewGeometry").outputs
    cosine = build.vector("DOT_PRODUCT", "Value", a=geometry["Incoming"], b=geometry["Normal"])
    entry = build.node("ShaderNodeCombineXYZ")
    build.feed(entry.inputs["X"], build.math("ABSOLUTE", cosine))
    build.feed(entry.inputs["Y"], roughness)
    # The first and last entries of the table are at 0 and 1, but texel centres are half a texel inside.
    size = np.array([values.shape[1], values.shape[0], 1.0])
    scale, shift = tuple(((size - 1.0) / size).tolist()), tuple((0.5 / size).tolist())
    uv = build.vector("MULTIPLY_ADD", "Vector", a=entry.outputs["Vector"], b=scale, c=shift)
    s0, s1, t = build.lookup(_table_image(f"{GROUP} 1", values[..., :3]), uv)
    f0, f1, e = build.lookup(_table_image(f"{GROUP} 2", values[..., 3:]), uv)

    mean = build.vector("DOT_PRODUCT", "Value", a=base_color, b=weights)
    above = build.math("SUBTRACT", mean, DIELECTRIC_REFLECTANCE)
    normal = build.math("MULTIPLY_ADD", metallic, above, DIELECTRIC_REFLECTANCE)
    wanted = build.math("MULTIPLY_ADD", normal, s0, s1)
    more = build.math("SUBTRACT", build.math("MULTIPLY_ADD", mean, f0, f1), e)
    there = build.math("MULTIPLY_ADD", metallic, more, e)
    share = build.math("MINIMUM", build.math("DIVIDE", wanted, there), 1.0)
    missing = build.math("SUBTRACT", 1.0, build.math("MULTIPLY", share, t))
    factor = build.math("MULTIPLY", build.math("SUBTRACT", 1.0, metallic), missing)

    diffuse = build.node("ShaderNodeBsdfDiffuse")
    build.feed(diffuse.inputs["Color"], build.vector("SCALE", "Vector", a=base_color, scale=factor))
    mix = build.node("ShaderNodeMixShader")  # its first shader is black
    build.feed(mix.inputs[0], share)
    build.feed(mix.inputs[2], inputs["BSDF"])
    add = build.node("ShaderNodeAddShader")
    build.feed(add.inputs[0], mix.outputs["Shader"])
    build.feed(add.inputs[1], diffuse.outputs["BSDF"])
    build.feed(build.node("NodeGroupOutput").inputs["BSDF"], add.outputs["Shader"])
