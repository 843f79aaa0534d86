# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The world for USD, in the one form that all versions of Blender's exporter write rightly.

The exporter takes the turn of a Mapping node for one of type Point whatever its type, and from Blender 5.0 on
it leaves the strength out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Matrix

from ..color_spaces import from_scene_linear
from ..image_datablocks import linear_values
from ..node_trees import node_tree


@dataclass(frozen=True)
class Environment:
    """What a world sends out.

    Attributes:
        image: equirectangular; None for a plain colour.
        factor: (3,) by which its radiance is multiplied, or the colour.
        lookup: world direction to the image's direction.
        whole: whether that is all the world's nodes do.
    """

    image: bpy.types.Image | None
    factor: np.ndarray
    lookup: Matrix
    whole: bool


def read_environment(world: bpy.types.World | None) -> Environment | None:
    """What a world sends out; None for a black one."""
    if world is None:
        return None
    identity = Matrix.Identity(3)
    tree = world.node_tree
    if tree is None or (bpy.app.version < (5, 0) and not world.use_nodes):
        return _unless_black(Environment(None, np.array(world.color), identity, True))
    output = tree.get_output_node("CYCLES")
    shader = None if output is None else _source(output.inputs["Surface"])
    if shader is None:
        return None
    if shader.bl_idname != "ShaderNodeBackground":
        return Environment(None, np.zeros(3), identity, False)
    color, strength = shader.inputs["Color"], shader.inputs["Strength"]
    factor, whole = np.full(3, 1.0 if strength.is_linked else strength.default_value), not strength.is_linked
    node = _source(color)
    if node is None:
        return _unless_black(Environment(None, factor * color.default_value[:3], identity, whole))
    if node.bl_idname != "ShaderNodeTexEnvironment" or node.image is None:
        return Environment(None, np.zeros(3), identity, False) if factor.any() else None
    lookup, is_turn = _lookup(node.inputs["Vector"])
    whole = whole and is_turn and node.projection == "EQUIRECTANGULAR"
    return _unless_black(Environment(node.image, factor, lookup, whole))


def _unless_black(environment: Environment) -> Environment | None:
    return environment if environment.factor.any() else None


def _source(socket: bpy.types.NodeSocket) -> bpy.types.Node | None:
    return socket.links[0].from_node if socket.is_linked else None


def _lookup(socket: bpy.types.NodeSocket) -> tuple[Matrix, bool]:
    """The turn by which an environment texture is looked up, and whether nothing else happens."""
    node = _source(socket)
    if node is None:
        return Matrix.Identity(3), True
    if node.bl_idname == "ShaderNodeTexCoord":
        return Matrix.Identity(3), socket.links[0].from_socket.name == "Generated" and node.object is None
    if node.bl_idname != "ShaderNodeMapping":
        return Matrix.Identity(3), False
    before, whole = _lookup(node.inputs["Vector"])
    values = {name: node.inputs.get(name) for name in ("Location", "Rotation", "Scale")}
    linked = any(socket is not None and socket.is_linked for socket in values.values())
    place = node.inputs["Location"].default_value if node.vector_type in ("POINT", "TEXTURE") else (0.0,) * 3
    whole = (
        whole and not linked and not any(place) and tuple(node.inputs["Scale"].default_value) == (1.0,) * 3
    )
    turn = Euler(node.inputs["Rotation"].default_value, "XYZ").to_matrix()
    if node.vector_type == "TEXTURE":
        turn.transpose()
    return turn @ before, whole


def plain_world(environment: Environment, path: Path) -> tuple[bpy.types.World, bpy.types.Image]:
    """A new world of the same light, of strength 1 and turned by a Mapping node of type Point.

    Args:
        environment: of a world whose nodes do no more.
        path: of the picture that is made for it, which ends in .exr.

    Returns:
        The world, and the picture.
    """
    world = bpy.data.worlds.new("World")
    tree = node_tree(world)
    tree.nodes.clear()
    kinds = ("TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld")
    coordinates, mapping, texture, background, output = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in kinds
    )
    for source, target in (
        (coordinates.outputs["Generated"], mapping.inputs["Vector"]),
        (mapping.outputs["Vector"], texture.inputs["Vector"]),
        (texture.outputs["Color"], background.inputs["Color"]),
        (background.outputs["Background"], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    mapping.vector_type = "POINT"
    mapping.inputs["Rotation"].default_value = environment.lookup.to_euler("XYZ")
    background.inputs["Strength"].default_value = 1.0
    texture.image = _image(environment, path)
    return world, texture.image


def _image(environment: Environment, path: Path) -> bpy.types.Image:
    """The radiance of an environment as a new EXR image, which readers take for linear Rec.709."""
    source = environment.image
    width, height = (4, 2) if source is None else tuple(source.size)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = environment.factor
    if source is not None:
        pixels[..., :3] *= linear_values(source)[..., :3]
    pixels[..., :3] = from_scene_linear(pixels[..., :3])
    # As data, since Blender 4.5 saves other new images of floats with sRGB's transfer function.
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "OPEN_EXR"
    image.save()
    bpy.data.images.remove(image)
    return bpy.data.images.load(str(path))
