# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated materials: one Principled material per atlas image, its maps in nodes with fixed names.

The artist's materials stay in the original meshes, which `room.originals` sets aside.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy

from ...core.run.documents import read_json
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ...core.run.shapes import TEXTURES
from ..image_datablocks import remove_unused_images
from ..marks import MAP, MATERIAL, OUTPUT, PRINCIPLED, TABLE
from ..node_trees import node_tree
from ..room.uv_layer import UV_LAYER
from ..texture_files import IN_RUN_FOLDER, TextureFiles

# With IOR 1.5 and level 0.5, Principled reflects 4 % at normal incidence, like the paper's dielectrics.
IOR = 1.5
SPECULAR_LEVEL = 0.5
# key of textures.json -> label, whether the values are data
MAPS = {
    "base_color": ("Base Color", False),
    "roughness": ("Roughness", True),
    "metallic": ("Metallic", True),
    "confidence": ("Confidence", True),
}


def result_materials(meshes: Iterable[bpy.types.Mesh]) -> dict[str, bpy.types.Material]:
    """The estimated materials of meshes, by the name of their atlas image."""
    materials = (material for mesh in meshes for material in mesh.materials if material is not None)
    return {material[MATERIAL]: material for material in materials if MATERIAL in material}


def remove_unused(materials: Iterable[bpy.types.Material]) -> None:
    """Remove those materials that nothing uses any more, and their textures."""
    unused = [material for material in materials if material.users == 0]
    images = {image for material in unused for image in _images(material.node_tree)}
    groups = {
        node.node_tree
        for material in unused
        for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and TABLE in node.node_tree
    }
    bpy.data.batch_remove(unused)
    remove_unused_images(images)
    for group in groups:
        if group.users == 0:
            tables = _images(group)
            bpy.data.node_groups.remove(group)
            remove_unused_images(tables)


def _images(tree: bpy.types.NodeTree) -> set[bpy.types.Image]:
    """The images of a tree's texture nodes."""
    textures = (node for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage")
    return {node.image for node in textures if node.image is not None}


def read_textures(run: RunFolder) -> list[dict[str, str]]:
    """The entries of textures.json.

    Raises:
        FiptError: ``file-missing`` for textures.json or a texture, or ``file-damaged``.
    """
    data = read_json(run.textures_json, TEXTURES, "Apply the results again.")
    entries: list[dict[str, str]] = data["images"]
    for entry in entries:
        for key in MAPS:
            path = run.resolve(entry[key])
            if not path.is_file():
                raise FiptError(
                    "file-missing", f"The texture {path} does not exist.", "Apply the results again."
                )
    return entries


def image_material(
    run: RunFolder,
    entry: Mapping[str, str],
    reuse: bpy.types.Material | None = None,
    files: TextureFiles = IN_RUN_FOLDER,
) -> bpy.types.Material:
    """The Principled material of one atlas image.

    Args:
        run: the run folder with the textures.
        entry: an entry of textures.json: name and paths of the maps.
        reuse: an estimated material to rebuild instead of making a new one.
        files: where the textures are kept.
    """
    earlier = set() if reuse is None else _images(reuse.node_tree)
    material, nodes = _new_material(entry["name"], reuse)
    links = material.node_tree.links
    principled = nodes[PRINCIPLED]
    uv = nodes.new("ShaderNodeUVMap")
    uv.name, uv.label, uv.uv_map = "FIPT UV", "Atlas UVs", UV_LAYER
    uv.location = (-760, 0)
    frame = _maps_frame(nodes)
    for row, (key, (label, is_data)) in enumerate(MAPS.items()):
        node = nodes.new("ShaderNodeTexImage")
        node.name = MAP.format(label)
        node.label = "Confidence (color, roughness, metallic)" if key == "confidence" else label
        node.image = files.load(run.resolve(entry[key]), is_data)
        node.extension = "EXTEND"
        node.location = (-480, 300 - 290 * row)
        node.parent = frame
        links.new(uv.outputs["UV"], node.inputs["Vector"])
        if label in principled.inputs:
            links.new(node.outputs["Color"], principled.inputs[label])
    remove_unused_images(earlier)
    for label, _ in MAPS.values():
        nodes[MAP.format(label)].image.name = f"{material.name} {label}"
    return material


def attribute_material(reuse: bpy.types.Material | None = None) -> bpy.types.Material:
    """The Principled material that reads the colour attributes."""
    material, nodes = _new_material("Room", reuse)
    principled = nodes[PRINCIPLED]
    frame = _maps_frame(nodes)
    for row, (label, _) in enumerate(MAPS.values()):
        node = nodes.new("ShaderNodeAttribute")
        node.name, node.label = MAP.format(label), label
        node.attribute_type, node.attribute_name = "GEOMETRY", MAP.format(label)
        node.location = (-400, 300 - 200 * row)
        node.parent = frame
        if label in principled.inputs:
            material.node_tree.links.new(node.outputs["Color"], principled.inputs[label])
    return material


def _maps_frame(nodes: bpy.types.Nodes) -> bpy.types.Node:
    frame = nodes.new("NodeFrame")
    frame.name, frame.label = "FIPT Maps", "Estimated from photographs"
    return frame


def _new_material(name: str, reuse: bpy.types.Material | None) -> tuple[bpy.types.Material, bpy.types.Nodes]:
    material = reuse or bpy.data.materials.new(f"FIPT {name}")
    material[MATERIAL] = name
    nodes = node_tree(material).nodes
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name, output.location = OUTPUT, (320, 300)
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    principled.name, principled.location = PRINCIPLED, (0, 300)
    # Single scattering, as in the paper; the default, multiple scattering, brightens rough metals.
    principled.distribution = "GGX"
    principled.inputs["IOR"].default_value = IOR
    principled.inputs["Specular IOR Level"].default_value = SPECULAR_LEVEL
    material.node_tree.links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    return material, nodes
