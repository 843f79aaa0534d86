# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials in the form that exporters understand: plain Principled with images, or with an emission."""

from __future__ import annotations

import re
from collections.abc import Sequence

import bpy

from ..marks import MAP, MATERIAL, PART_NAME
from ..node_trees import node_tree
from ..results import adjust
from ..results.materials import is_uniform, uniform_values
from ..room.uv_layer import UV_LAYER
from .part_textures import PartTextures


def plain_material(material: bpy.types.Material, textures: PartTextures | None) -> bpy.types.Material:
    """A new Principled material of a part with the exported textures; of one value without (None)."""
    made = bpy.data.materials.new(material.name)
    principled = _principled(made)
    if textures is None:
        values = adjust.adjusted(adjust.read(material), uniform_values(material)[None])[0].tolist()
        sockets = {"Base Color": (*values[:3], 1.0), "Roughness": values[3], "Metallic": values[4]}
        for name, value in sockets.items():
            principled.inputs[name].default_value = value
        return made
    tree = node_tree(made)
    uv = tree.nodes.new("ShaderNodeUVMap")
    uv.uv_map = UV_LAYER

    def texture(image: bpy.types.Image) -> bpy.types.NodeSocket:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.extension = image, "EXTEND"
        tree.links.new(uv.outputs["UV"], node.inputs["Vector"])
        return node.outputs["Color"]

    tree.links.new(texture(textures.base_color), principled.inputs["Base Color"])
    channels = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(texture(textures.orm), channels.inputs["Color"])
    tree.links.new(channels.outputs["Green"], principled.inputs["Roughness"])
    tree.links.new(channels.outputs["Blue"], principled.inputs["Metallic"])
    return made


def artists_name(material: bpy.types.Material, name: str) -> str:
    """The name of a part, or the `name` of its estimated material where the artist has given it one."""
    part = str(material.get(PART_NAME, ""))
    ours = re.fullmatch(rf"{re.escape(part)} FIPT(\.\d+)?", name)
    return part if part and ours else name


def glowing_material(name: str, radiance: Sequence[float], one_sided: bool) -> bpy.types.Material:
    """A new Principled material that emits a radiance (rgb, scene-linear), W/(m² sr) or nits.

    Args:
        name: of the material.
        radiance: rgb.
        one_sided: only its front is drawn, where the other program heeds that.
    """
    made = bpy.data.materials.new(name)
    principled = _principled(made)
    strength = max(radiance)
    color = [value / strength for value in radiance] if strength > 0.0 else [0.0, 0.0, 0.0]
    for socket, value in (
        ("Base Color", (0.0, 0.0, 0.0, 1.0)),
        ("Roughness", 1.0),
        ("Specular IOR Level", 0.0),
        ("Emission Color", (*color, 1.0)),
        ("Emission Strength", strength),
    ):
        principled.inputs[socket].default_value = value
    made.use_backface_culling = one_sided
    return made


def _principled(material: bpy.types.Material) -> bpy.types.Node:
    nodes = node_tree(material).nodes
    nodes.clear()
    principled, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    node_tree(material).links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    return principled


def has_maps(material: bpy.types.Material | None) -> bool:
    """Whether a material is an estimated one with images, or with constants in their place."""
    if material is None or MATERIAL not in material:
        return False
    if is_uniform(material):
        return True
    node = node_tree(material).nodes.get(MAP.format("Base Color"))
    return node is not None and node.bl_idname == "ShaderNodeTexImage"
