"""Our world for USD, in the one form that all versions of Blender's exporter write rightly.

The exporter takes the turn of a Mapping node for one of type Point whatever its type, and from Blender 5.0 on
it leaves the strength out.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Euler

from ..color_spaces import from_scene_linear
from ..image_datablocks import linear_values, save_values
from ..lights.world import ENVIRONMENT
from ..marks import BACKGROUND, MAPPING, WORLD
from ..node_trees import node_tree


def is_dark(world: bpy.types.World | None) -> bool:
    """Whether there is no world, or one of ours that is black or switched off."""
    if world is None or WORLD not in world:
        return world is None
    background = node_tree(world).nodes.get(BACKGROUND)
    return not world[WORLD] or background is None or background.inputs["Strength"].default_value <= 0.0


def plain_world(world: bpy.types.World, path: Path) -> tuple[bpy.types.World, bpy.types.Image] | None:
    """A copy of our world with its strength in its picture, turned by a Mapping node of type Point.

    Args:
        world: made by `lights.world`, not dark.
        path: of the picture that is made for it, which ends in .exr.

    Returns:
        The world and the picture; None for a world whose nodes the artist has removed.
    """
    if not {ENVIRONMENT, MAPPING} <= set(node_tree(world).nodes.keys()):
        return None
    made = world.copy()
    nodes = node_tree(made).nodes
    mapping, background, texture = nodes[MAPPING], nodes[BACKGROUND], nodes[ENVIRONMENT]
    if mapping.vector_type == "TEXTURE":
        turn = Euler(mapping.inputs["Rotation"].default_value, "XYZ").to_matrix().transposed()
        mapping.vector_type = "POINT"
        mapping.inputs["Rotation"].default_value = turn.to_euler("XYZ")
    # Radiance, which readers take for linear Rec.709.
    radiance = background.inputs["Strength"].default_value * linear_values(texture.image)[..., :3]
    save_values(from_scene_linear(radiance), path)
    texture.image = bpy.data.images.load(str(path))
    background.inputs["Strength"].default_value = 1.0
    return made, texture.image
