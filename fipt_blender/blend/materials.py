# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results onto the room: one Principled material an atlas image, emission materials a fixture.

Nodes carry fixed names (``FIPT Base Color`` ...), so that later code can rewire them. The artist's own
materials stay in his meshes, which `originals` sets aside.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from .fixtures import add_fixtures
from .images import load_texture
from .originals import original_polygons
from .room_export import Room, is_mirrored, read_room, triangle_loops
from .uvs import UV_LAYER, own_meshes, write_layer

# Principled's IOR of 1.5 and level of 0.5 reflect 4 % at normal incidence, as the paper's dielectrics do.
IOR = 1.5
SPECULAR_LEVEL = 0.5
# key of textures.json -> label, whether the values are data, height in the node editor
MAPS = {
    "base_color": ("Base Color", False),
    "roughness": ("Roughness", True),
    "metallic": ("Metallic", True),
    "coverage": ("Coverage", True),
}
COLOR_ATTRIBUTE = "FIPT {}"


@dataclass
class Applied:
    """What `apply_results` put into the file."""

    materials: list[str] = field(default_factory=list)
    fixtures: list[str] = field(default_factory=list)


def apply_results(run: RunFolder, objects: Iterable[bpy.types.Object]) -> Applied:
    """Put textures and emitters of a finished run onto the room.

    Args:
        run: with atlas, textures and results/emitters.json.
        objects: the room's objects; those that carry results already get them anew.

    Raises:
        FiptError: ``room-changed``, ``file-missing`` or ``file-damaged``.
    """
    room = read_room(run)
    atlas = read_json(run.atlas_json)
    with np.load(run.atlas_npz, allow_pickle=False) as arrays:
        triangle_image, corner_uv = arrays["triangle_image"], arrays["corner_uv"]
    ordered = own_meshes(room, objects)
    by_name = {item.name: item for item in ordered}
    applied = Applied()
    if atlas["mode"] == "color_attribute":
        materials = [attribute_material()]
        _write_attributes(run, room, by_name)
        triangle_image = np.zeros_like(triangle_image)
    else:
        entries = read_json(run.textures_json)["images"]
        materials = [image_material(run, entry) for entry in entries]
        for index, item in enumerate(ordered):
            write_layer(item, corner_uv[room.triangle_object == index])
    applied.materials = [material.name for material in materials]
    for index, item in enumerate(ordered):
        _assign(item.data, room, index, triangle_image, materials)
    applied.fixtures = add_fixtures(run, room, by_name)
    return applied


def _assign(
    mesh: bpy.types.Mesh,
    room: Room,
    index: int,
    triangle_image: np.ndarray,
    materials: list[bpy.types.Material],
) -> None:
    """One slot for each atlas image that the object uses."""
    mine = room.triangle_object == index
    polygon, image = room.triangle_polygon[mine], triangle_image[mine]
    original = original_polygons(mesh)
    polygon_image = np.full(max(int(polygon.max(initial=-1)), int(original.max(initial=-1))) + 1, -1)
    # Triangles without area have no image (-1); the polygon takes that of the others.
    order = np.argsort(image, kind="stable")
    polygon_image[polygon[order]] = image[order]
    used = [int(each) for each in np.unique(polygon_image[original]) if each >= 0] or [0]
    slot = np.zeros(len(materials) + 1, np.int32)
    slot[used] = np.arange(len(used))
    mesh.materials.clear()
    for each in used:
        mesh.materials.append(materials[each])
    mesh.polygons.foreach_set("material_index", slot[polygon_image[original]])
    mesh.update()


def image_material(run: RunFolder, entry: dict[str, str]) -> bpy.types.Material:
    """The Principled material of one atlas image.

    Args:
        run: whose textures they are.
        entry: of textures.json: name and paths of the maps.
    """
    material, nodes = new_material(f"FIPT {entry['name']}")
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
        node.label = "Coverage (1 = seen in a photograph)" if key == "coverage" else label
        path = run.resolve(entry[key])
        if not Path(path).is_file():
            raise FiptError("file-missing", f"The texture {path} does not exist.", "Bake the textures again.")
        node.image = load_texture(path, is_data)
        node.image.name = f"{material.name} {label}"
        node.extension = "EXTEND"
        node.location = (-480, 300 - 290 * row)
        node.parent = frame
        links.new(uv.outputs["UV"], node.inputs["Vector"])
        if label in principled.inputs:
            links.new(node.outputs["Color"], principled.inputs[label])
    return material


def attribute_material() -> bpy.types.Material:
    """The Principled material that reads the colour attributes."""
    material, nodes = new_material("FIPT Room")
    principled = nodes["FIPT Principled"]
    frame = nodes.new("NodeFrame")
    frame.name, frame.label = "FIPT Maps", "Estimated from photographs"
    for row, (label, is_data) in enumerate(MAPS.values()):
        node = nodes.new("ShaderNodeAttribute")
        node.name, node.label = f"FIPT {label}", label
        node.attribute_type, node.attribute_name = "GEOMETRY", COLOR_ATTRIBUTE.format(label)
        node.location = (-400, 300 - 200 * row)
        node.parent = frame
        if label in principled.inputs:
            output = node.outputs["Fac" if is_data else "Color"]
            material.node_tree.links.new(output, principled.inputs[label])
    return material


def new_material(name: str) -> tuple[bpy.types.Material, bpy.types.Nodes]:
    """A material with an empty tree but for Principled and output; one of the same name is made anew."""
    material = bpy.data.materials.get(name) or bpy.data.materials.new(name)
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


def _write_attributes(run: RunFolder, room: Room, by_name: dict[str, bpy.types.Object]) -> None:
    path = run.textures / "corner_fields.npz"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            fields = {key: arrays[key] for key in MAPS}
    except (OSError, KeyError, ValueError) as error:
        raise FiptError(
            "file-damaged", f"{path} can't be read ({error}).", "Bake the textures again."
        ) from None
    for index, name in enumerate(room.objects):
        item = by_name[name]
        mine = room.triangle_object == index
        loops, _ = triangle_loops(item.data, is_mirrored(item))
        for key, (label, is_data) in MAPS.items():
            attribute_name = COLOR_ATTRIBUTE.format(label)
            old = item.data.attributes.get(attribute_name)
            if old is not None:
                item.data.attributes.remove(old)
            kind = "FLOAT" if is_data else "FLOAT_COLOR"
            attribute = item.data.attributes.new(attribute_name, kind, "CORNER")
            values = np.zeros((len(item.data.loops), 1 if is_data else 4), np.float32)
            corner = fields[key][mine].reshape(len(loops) * 3, -1)
            values[loops.ravel(), : corner.shape[1]] = corner
            if not is_data:
                values[:, 3] = 1.0
            attribute.data.foreach_set("value" if is_data else "color", values.ravel())
