# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials in the form that exporters understand: plain Principled with images, or with an emission."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..marks import MAP, MATERIAL, PART, PART_NAME
from ..node_trees import node_tree
from ..results import adjust
from ..results.materials import is_uniform, uniform_values
from ..room.mesh_arrays import corner_uvs, polygon_slots, triangle_loops
from ..room.tiles import image_uvs, polygon_images, tile_number
from ..room.uv_layer import UV_LAYER
from .textures import adjusted_maps, read_maps, texel_parts, write_png


@dataclass(frozen=True)
class Atlas:
    """The exported textures of an atlas image.

    Attributes:
        base_color: sRGB. roughness_metallic: green and blue, as in glTF.
        roughness, metallic: grey, where the format has an image for each.
    """

    base_color: bpy.types.Image
    roughness_metallic: bpy.types.Image | None = None
    roughness: bpy.types.Image | None = None
    metallic: bpy.types.Image | None = None

    @property
    def images(self) -> list[bpy.types.Image]:
        """All of them."""
        images = (self.base_color, self.roughness_metallic, self.roughness, self.metallic)
        return [image for image in images if image is not None]


# An atlas image: name of the atlas, and its index there.
AtlasKey = tuple[str, int]


def make_atlases(meshes: list[bpy.types.Mesh], folder: Path, packed: bool) -> dict[AtlasKey, Atlas]:
    """Write the textures of all atlas images that objects with results use.

    Args:
        meshes: of these objects, as renders show them.
        folder: for the files.
        packed: roughness and metallic in one image, as glTF has them; otherwise in two.
    """
    materials: dict[AtlasKey, dict[str, bpy.types.Material]] = {}
    for mesh in meshes:
        pairs = np.unique(np.stack([polygon_slots(mesh), polygon_images(mesh)], axis=1), axis=0)
        for slot, image in pairs.tolist():
            material = mesh.materials[min(slot, len(mesh.materials) - 1)] if mesh.materials else None
            if material is not None and has_maps(material) and not is_uniform(material):
                materials.setdefault((material[MATERIAL], image), {})[material.get(PART, "")] = material
    atlases = {}
    tiled = {atlas for atlas, number in materials if number > 0}
    for key, by_part in sorted(materials.items()):
        first, (atlas, number) = next(iter(by_part.values())), key
        name = f"{atlas}.{tile_number(number)}" if atlas in tiled else atlas
        maps = read_maps(first, number)
        keys = list(by_part)
        changed = {
            index: adjust.read(by_part[key])
            for index, key in enumerate(keys)
            if adjust.read(by_part[key]) != adjust.NO_ADJUSTMENT
        }
        if changed:
            corner_uv, part = _triangles(meshes, key, keys)
            size = (maps.shape[1], maps.shape[0])
            maps = adjusted_maps(maps, texel_parts(corner_uv, part, size), changed)
        atlases[key] = _write(maps, name, folder, packed)
    return atlases


def _write(maps: np.ndarray, name: str, folder: Path, packed: bool) -> Atlas:
    base_color = write_png(maps[..., :3], folder / f"{name}_base_color.png", False)
    if packed:
        values = np.stack([np.ones_like(maps[..., 3]), maps[..., 3], maps[..., 4]], axis=2)
        path = folder / f"{name}_roughness_metallic.png"
        return Atlas(base_color, roughness_metallic=write_png(values, path, True))
    grey = [
        write_png(np.repeat(maps[..., 3 + index, None], 3, axis=2), folder / f"{name}_{label}.png", True)
        for index, label in enumerate(("roughness", "metallic"))
    ]
    return Atlas(base_color, roughness=grey[0], metallic=grey[1])


def _triangles(
    meshes: list[bpy.types.Mesh], image: AtlasKey, keys: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 2) UVs and (T,) indices into `keys` of all triangles on an atlas image."""
    atlas, number = image
    uvs, parts = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    for mesh in meshes:
        of_slot = np.array(
            [
                keys.index(material[PART])
                if material is not None and material.get(MATERIAL) == atlas and material[PART] in keys
                else -1
                for material in mesh.materials
            ]
            or [-1]
        )
        loops, polygons = triangle_loops(mesh, False)
        part = of_slot[np.minimum(polygon_slots(mesh), len(of_slot) - 1)]
        part = np.where(polygon_images(mesh) == number, part, -1)[polygons]
        uvs.append(image_uvs(corner_uvs(mesh, mesh.uv_layers[UV_LAYER])[loops[part >= 0]], number))
        parts.append(part[part >= 0])
    return np.concatenate(uvs), np.concatenate(parts)


def plain_material(material: bpy.types.Material, atlas: Atlas | None) -> bpy.types.Material:
    """A new Principled material of a part with the exported textures; of one value without (None)."""
    made = bpy.data.materials.new(material.name)
    principled = _principled(made)
    if atlas is None:
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

    tree.links.new(texture(atlas.base_color), principled.inputs["Base Color"])
    if atlas.roughness_metallic is not None:
        parts = tree.nodes.new("ShaderNodeSeparateColor")
        tree.links.new(texture(atlas.roughness_metallic), parts.inputs["Color"])
        tree.links.new(parts.outputs["Green"], principled.inputs["Roughness"])
        tree.links.new(parts.outputs["Blue"], principled.inputs["Metallic"])
    else:
        tree.links.new(texture(atlas.roughness), principled.inputs["Roughness"])
        tree.links.new(texture(atlas.metallic), principled.inputs["Metallic"])
    return made


def artists_name(material: bpy.types.Material, name: str) -> str:
    """The name of a part, or the `name` of its estimated material where the artist has given it one."""
    part = str(material.get(PART_NAME, ""))
    ours = re.fullmatch(rf"{re.escape(part)} FIPT(\.\d+)?", name)
    return part if part and ours else name


def glowing_material(name: str, radiance: tuple[float, ...], one_sided: bool) -> bpy.types.Material:
    """A new Principled material that emits a radiance (rgb, scene-linear, W/(m² sr)).

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
