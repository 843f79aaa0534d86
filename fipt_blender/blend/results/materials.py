"""The estimated materials: a Principled material for each part, its maps in nodes with fixed names.

Parts share the atlas images; a part on several images has a material for each. The artist's materials stay in
the original meshes, which `room.originals` sets aside.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import bpy
import numpy as np

from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.result_contents import TextureImage, Textures
from ...core.run.runfolder import RunFolder
from ..color_spaces import to_scene_linear
from ..image_datablocks import remove_unused_images
from ..marks import ESTIMATE, MAP, MATERIAL, OUTPUT, PART, PART_NAME, PRINCIPLED, TABLE
from ..node_trees import node_tree
from ..room.uv_layer import UV_LAYER
from ..texture_files import TextureFiles
from . import adjust

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


def result_materials(meshes: Iterable[bpy.types.Mesh]) -> list[bpy.types.Material]:
    """The estimated materials of meshes, each once, those among them that others have replaced."""
    materials = (material for mesh in meshes for material in slot_estimates(mesh) if material is not None)
    return list(dict.fromkeys(materials))


def slot_estimates(mesh: bpy.types.Mesh) -> list[bpy.types.Material | None]:
    """The estimated material of each slot of a result mesh, None where the artist's material was kept."""
    found = []
    for index, material in enumerate(mesh.materials):
        own = material is not None and MATERIAL in material
        found.append(material if own else mesh.get(ESTIMATE.format(index)))
    return found


def used_alone(
    materials: Sequence[bpy.types.Material], meshes: Collection[bpy.types.Mesh]
) -> list[bpy.types.Material]:
    """Those materials that no other mesh uses, nor a slot of an object: copies of a scene keep theirs."""
    if not materials:
        return []
    users = bpy.data.user_map(subset=materials, key_types={"MATERIAL"}, value_types={"MESH", "OBJECT"})
    return [material for material in materials if users.get(material, set()) <= set(meshes)]


def materials_by_part(materials: Iterable[bpy.types.Material]) -> dict[str, list[bpy.types.Material]]:
    """Estimated materials by the keys of their parts."""
    by_part: dict[str, list[bpy.types.Material]] = {}
    for material in materials:
        by_part.setdefault(material.get(PART, ""), []).append(material)
    return by_part


def remove_unused(materials: Iterable[bpy.types.Material]) -> None:
    """Remove those materials that nothing uses any more, and their textures."""
    unused = [material for material in materials if material.users == 0]
    images = images_of(unused)
    groups = {
        node.node_tree
        for material in unused
        for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeGroup"
        and node.node_tree is not None
        and (TABLE in node.node_tree or adjust.is_adjustment(node.node_tree))
    }
    bpy.data.batch_remove(unused)
    remove_unused_images(images)
    for group in groups:
        if group.users == 0:
            tables = _images(group)
            bpy.data.node_groups.remove(group)
            remove_unused_images(tables)


def images_of(materials: Iterable[bpy.types.Material]) -> set[bpy.types.Image]:
    """The images of the materials' own texture nodes."""
    return {image for material in materials for image in _images(material.node_tree)}


def _images(tree: bpy.types.NodeTree) -> set[bpy.types.Image]:
    """The images of a tree's texture nodes."""
    textures = (node for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage")
    return {node.image for node in textures if node.image is not None}


def read_textures(run: RunFolder) -> tuple[Sequence[TextureImage], dict[str, tuple[float, ...]]]:
    """The images of textures.json, and what parts of one value have, by their keys in `part_material`."""
    textures = read_document(run.textures_json, Textures, "Apply the results again.")
    for image in textures.images:
        for key in MAPS:
            path = run.resolve(getattr(image, key))
            if not path.is_file():
                raise FiptError("file-missing.read-textures", path=path)
    uniform: dict[str, tuple[float, ...]] = {
        each.part: (*each.base_color, each.roughness, each.metallic) for each in textures.uniform
    }
    return textures.images, uniform


def load_maps(run: RunFolder, entry: TextureImage, files: TextureFiles) -> dict[str, bpy.types.Image]:
    """The images of an entry of textures.json, by the labels of their maps."""
    return {
        label: files.load(run.resolve(getattr(entry, key)), is_data) for key, (label, is_data) in MAPS.items()
    }


def part_material(
    image: str,
    key: str,
    name: str,
    images: Mapping[str, bpy.types.Image] | None = None,
    adjustment: adjust.Adjustment = adjust.NO_ADJUSTMENT,
    values: Sequence[float] | None = None,
    reuse: bpy.types.Material | None = None,
) -> bpy.types.Material:
    """The Principled material of a part, with the artist's adjustment between its maps and the shader.

    Args:
        image: name of the atlas image.
        key, name: of the part, see `core.run.parts`.
        images: the maps of the atlas image by their labels (`load_maps`); None for colour attributes.
        adjustment: of the part.
        values: base colour, roughness and metallic (5,) of a part of one value, which needs no textures.
        reuse: an estimated material to rebuild instead of making a new one.
    """
    material = reuse or bpy.data.materials.new(f"{name} FIPT")
    material[MATERIAL], material[PART], material[PART_NAME] = image, key, name
    nodes, links = node_tree(material).nodes, node_tree(material).links
    nodes.clear()
    _add_shader(material)
    frame = nodes.new("NodeFrame")
    frame.name, frame.label = "FIPT Maps", "Estimated from photographs"
    if images is None:
        _add_attributes(material, frame)
    else:
        _add_textures(material, frame, images)
    if values is not None:
        _add_values(material, frame, values)
    node = adjust.add_adjustment(material, adjustment)
    node.location = (-220, 300)
    for label in adjust.MAPS:
        links.new(node.outputs[label], nodes[PRINCIPLED].inputs[label])
    return material


def _add_shader(material: bpy.types.Material) -> None:
    nodes = material.node_tree.nodes
    output = nodes.new("ShaderNodeOutputMaterial")
    output.name, output.location = OUTPUT, (320, 300)
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    principled.name, principled.location = PRINCIPLED, (0, 300)
    # Single scattering, as in the paper; the default, multiple scattering, brightens rough metals.
    principled.distribution = "GGX"
    principled.inputs["IOR"].default_value = IOR
    principled.inputs["Specular IOR Level"].default_value = SPECULAR_LEVEL
    material.node_tree.links.new(principled.outputs["BSDF"], output.inputs["Surface"])


def _add_textures(
    material: bpy.types.Material, frame: bpy.types.Node, images: Mapping[str, bpy.types.Image]
) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    uv = nodes.new("ShaderNodeUVMap")
    uv.name, uv.label, uv.uv_map = "FIPT UV", "Atlas UVs", UV_LAYER
    uv.location = (-860, 0)
    for row, (label, image) in enumerate(images.items()):
        node = nodes.new("ShaderNodeTexImage")
        node.name = MAP.format(label)
        node.label = "Confidence (color, roughness, metallic)" if label == "Confidence" else label
        node.image = image
        node.extension = "EXTEND"
        node.location = (-580, 300 - 290 * row)
        node.parent = frame
        links.new(uv.outputs["UV"], node.inputs["Vector"])


def _add_values(material: bpy.types.Material, frame: bpy.types.Node, values: Sequence[float]) -> None:
    """Constants in place of all maps but confidence; roughness and metallic are greys, as in the images."""
    nodes = material.node_tree.nodes
    colors = {
        "Base Color": tuple(to_scene_linear(values[:3]).tolist()),
        "Roughness": (values[3],) * 3,
        "Metallic": (values[4],) * 3,
    }
    for label, color in colors.items():
        before = nodes[MAP.format(label)]
        place = before.location.copy()
        nodes.remove(before)
        node = nodes.new("ShaderNodeRGB")
        node.name, node.label = MAP.format(label), label
        node.outputs["Color"].default_value = (*color, 1.0)
        node.parent, node.location = frame, place
    nodes.active = nodes[MAP.format("Base Color")]


def is_uniform(material: bpy.types.Material) -> bool:
    """Whether an estimated material has constants in place of textures."""
    node = node_tree(material).nodes.get(MAP.format("Base Color"))
    return node is not None and node.bl_idname == "ShaderNodeRGB"


def uniform_values(material: bpy.types.Material) -> np.ndarray:
    """(5,) base colour (scene-linear), roughness and metallic of a material of one value, as estimated."""
    nodes = node_tree(material).nodes
    color, *others = (list(nodes[MAP.format(label)].outputs["Color"].default_value) for label in adjust.MAPS)
    return np.array([*color[:3], *(other[0] for other in others)])


def _add_attributes(material: bpy.types.Material, frame: bpy.types.Node) -> None:
    nodes = material.node_tree.nodes
    for row, (label, _) in enumerate(MAPS.values()):
        node = nodes.new("ShaderNodeAttribute")
        node.name, node.label = MAP.format(label), label
        node.attribute_type, node.attribute_name = "GEOMETRY", MAP.format(label)
        node.location = (-580, 300 - 200 * row)
        node.parent = frame
