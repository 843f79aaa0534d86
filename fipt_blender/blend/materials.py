# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated materials: one Principled material an atlas image, its maps in nodes of fixed names.

The artist's own materials stay in his meshes, which `originals` sets aside.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from .images import load_texture, remove_unused_images
from .uvs import UV_LAYER
from .write_back_nodes import MADE_FOR

# Principled's IOR of 1.5 and level of 0.5 reflect 4 % at normal incidence, as the paper's dielectrics do.
IOR = 1.5
SPECULAR_LEVEL = 0.5
# key of textures.json -> label, whether the values are data
MAPS = {
    "base_color": ("Base Color", False),
    "roughness": ("Roughness", True),
    "metallic": ("Metallic", True),
    "confidence": ("Confidence", True),
}
COLOR_ATTRIBUTE = "FIPT {}"
MATERIAL = "fipt_material"  # marks a material as ours; its value is what it was made for


def own_materials(meshes: Iterable[bpy.types.Mesh]) -> dict[str, bpy.types.Material]:
    """The materials of ours that meshes use, by what they were made for."""
    found = {}
    for mesh in meshes:
        for material in mesh.materials:
            if material is not None and MATERIAL in material:
                found[material[MATERIAL]] = material
    return found


def remove_unused(materials: Iterable[bpy.types.Material]) -> None:
    """Remove those materials that nothing uses any more, and their textures."""
    unused = [material for material in materials if material.users == 0]
    images = [
        node.image
        for material in unused
        for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeTexImage" and node.image is not None
    ]
    groups = {
        node.node_tree
        for material in unused
        for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and MADE_FOR in node.node_tree
    }
    bpy.data.batch_remove(unused)
    remove_unused_images(set(images))
    for group in groups:
        if group.users == 0:
            tables = [node.image for node in group.nodes if node.bl_idname == "ShaderNodeTexImage"]
            bpy.data.node_groups.remove(group)
            remove_unused_images({image for image in tables if image is not None})


def read_textures(run: RunFolder) -> list[dict[str, str]]:
    """The entries of textures.json.

    Raises:
        FiptError: ``file-missing``, also where a texture itself is, or ``file-damaged``.
    """
    entries: list[dict[str, str]] = read_json(run.textures_json)["images"]
    for entry in entries:
        for key in MAPS:
            path = run.resolve(entry[key])
            if not path.is_file():
                raise FiptError(
                    "file-missing", f"The texture {path} does not exist.", "Apply the results again."
                )
    return entries


def image_material(
    run: RunFolder, entry: Mapping[str, str], reuse: bpy.types.Material | None = None
) -> bpy.types.Material:
    """The Principled material of one atlas image.

    Args:
        run: whose textures they are.
        entry: of textures.json: name and paths of the maps.
        reuse: a material of ours to make anew.
    """
    material, nodes = _new_material(entry["name"], reuse)
    links = material.node_tree.links
    principled = nodes["FIPT Principled"]
    uv = nodes.new("ShaderNodeUVMap")
    uv.name, uv.label, uv.uv_map = "FIPT UV", "Atlas UVs", UV_LAYER
    uv.location = (-760, 0)
    frame = nodes.new("NodeFrame")
    frame.name, frame.label = "FIPT Maps", "Estimated from photographs"
    for row, (key, (label, is_data)) in enumerate(MAPS.items()):
        node = nodes.new("ShaderNodeTexImage")
        node.name = f"FIPT {label}"
        node.label = "Confidence (of colour, roughness, metallic)" if key == "confidence" else label
        node.image = load_texture(run.resolve(entry[key]), is_data)
        node.image.name = f"{material.name} {label}"
        node.extension = "EXTEND"
        node.location = (-480, 300 - 290 * row)
        node.parent = frame
        links.new(uv.outputs["UV"], node.inputs["Vector"])
        if label in principled.inputs:
            links.new(node.outputs["Color"], principled.inputs[label])
    return material


def attribute_material(reuse: bpy.types.Material | None = None) -> bpy.types.Material:
    """The Principled material that reads the colour attributes."""
    material, nodes = _new_material("Room", reuse)
    principled = nodes["FIPT Principled"]
    frame = nodes.new("NodeFrame")
    frame.name, frame.label = "FIPT Maps", "Estimated from photographs"
    for row, (label, _) in enumerate(MAPS.values()):
        node = nodes.new("ShaderNodeAttribute")
        node.name, node.label = f"FIPT {label}", label
        node.attribute_type, node.attribute_name = "GEOMETRY", COLOR_ATTRIBUTE.format(label)
        node.location = (-400, 300 - 200 * row)
        node.parent = frame
        if label in principled.inputs:
            material.node_tree.links.new(node.outputs["Color"], principled.inputs[label])
    return material


def _new_material(name: str, reuse: bpy.types.Material | None) -> tuple[bpy.types.Material, bpy.types.Nodes]:
    material = reuse or bpy.data.materials.new(f"FIPT {name}")
    material[MATERIAL] = name
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name, output.location = "FIPT Output", (320, 300)
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    principled.name, principled.location = "FIPT Principled", (0, 300)
    # Single scattering, as in the paper; the multi-scattering default adds energy to rough metals.
    principled.distribution = "GGX"
    principled.inputs["IOR"].default_value = IOR
    principled.inputs["Specular IOR Level"].default_value = SPECULAR_LEVEL
    material.node_tree.links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    return material, nodes
