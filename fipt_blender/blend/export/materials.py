"""Materials in the form that exporters understand: plain Principled with 8-bit images, or one that emits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..color_spaces import from_scene_linear
from ..image_datablocks import image_values, load_texture, save_values
from ..lights.fixture_nodes import side_radiance
from ..marks import MAP, MATERIAL, PART_NAME
from ..node_trees import node_tree
from ..png16 import encode_srgb
from ..results import adjust
from ..results.materials import is_uniform, uniform_values
from ..room.uv_layer import UV_LAYER

# Relative difference of a lamp's sides, below which they are alike.
_ALIKE = 1e-3
# Width and height of the largest exported texture, in texels, unless another is chosen.
TEXTURE_SIZE = 4096


@dataclass(frozen=True)
class PlainTextures:
    """The exported textures of materials.

    Attributes:
        base_color: sRGB.
        orm: occlusion (1: none), roughness and metallic in red, green and blue, as in glTF.
    """

    base_color: bpy.types.Image
    orm: bpy.types.Image


def texture_key(material: bpy.types.Material) -> tuple[bpy.types.Image, adjust.Adjustment]:
    """What an estimated material's exported textures depend on; those of one key are shared."""
    return _image(material, "Base Color"), adjust.read(material)


def plain_textures(material: bpy.types.Material, stem: str, size: int) -> PlainTextures:
    """Write the textures of an estimated material with the artist's adjustment in them.

    Args:
        material: with images.
        stem: path that the files' names begin with.
        size: the most texels of a texture's side; larger ones are scaled down.
    """
    maps = [image_values(_image(material, label)) for label in adjust.MAPS]
    codes = np.ones((2, *maps[0].shape[:2], 3), np.float32)
    for base_color, orm, *row in zip(*codes, *maps, strict=True):  # all at once take much memory
        values = np.column_stack([row[0][:, :3], row[1][:, 0], row[2][:, 0]])
        values = adjust.adjusted(adjust.read(material), values)
        base_color[:], orm[:, 1:] = encode_srgb(from_scene_linear(values[:, :3])), values[:, 3:]
    paths = [Path(f"{stem}_base_color.png"), Path(f"{stem}_orm.png")]
    for path, pixels in zip(paths, codes, strict=True):
        save_values(pixels, path, size)
    return PlainTextures(load_texture(paths[0], False), load_texture(paths[1], True))


def _image(material: bpy.types.Material, label: str) -> bpy.types.Image:
    return node_tree(material).nodes[MAP.format(label)].image


def plain_material(material: bpy.types.Material, textures: PlainTextures | None) -> bpy.types.Material:
    """A new Principled material of a part with exported textures; of one value without (None)."""
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


def plain_lamp(material: bpy.types.Material, unit: float) -> bpy.types.Material:
    """A new Principled material that emits as the brighter side of a lamp's, on one side where they differ.

    Args:
        material: made by `emission_material`.
        unit: by which radiance, W/(m² sr), is multiplied; 0 for a dark one.
    """
    front, back = side_radiance(material)
    radiance = [unit * value for value in max(front, back, key=max)]
    made = bpy.data.materials.new(material.name)
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
    made.use_backface_culling = max(front) > (1.0 + _ALIKE) * max(back)
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
