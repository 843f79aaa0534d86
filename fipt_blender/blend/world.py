# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated environment as the scene's world; black where there is none."""

from __future__ import annotations

import bpy

from ..core.job.runfolder import RunFolder, read_json
from ..properties.lights import MAPPING, OWN_WORLD, WORLD
from .images import load_texture, remove_unused_images
from .light_state import BACKGROUND, own_world, refresh_world

NAME = "FIPT World"
ORIGINAL_WORLD = "fipt_original_world"


def apply_environment(run: RunFolder, scene: bpy.types.Scene | None = None) -> bpy.types.World:
    """Give the scene a world with the run's environment map, or a black one.

    The scene's own world is kept in a custom property; `restore_world` brings it back. Settings of an
    environment that was there already stay.

    Args:
        run: results/emitters.json and the image that it names are read.
        scene: the context's by default.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    environment = read_json(run.emitters_json).get("environment")
    image = load_texture(run.results / environment["image"], is_data=False) if environment else None
    scene = scene or bpy.context.scene
    world = own_world(scene)
    rotation = 0.0
    if world is None:
        world = bpy.data.worlds.new(NAME)
    elif MAPPING in world.node_tree.nodes:
        rotation = world.node_tree.nodes[MAPPING].inputs["Rotation"].default_value[2]
    show_original_world(scene, False)
    if scene.world != world:
        if scene.world is not None:
            scene[ORIGINAL_WORLD] = scene.world
        scene.world = world
    world[WORLD] = int(image is not None)
    if world.node_tree is None:
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputWorld")
    output.location = (300, 0)
    background = nodes.new("ShaderNodeBackground")
    background.name = BACKGROUND
    background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    links.new(background.outputs["Background"], output.inputs["Surface"])
    if image is not None:
        coordinates = nodes.new("ShaderNodeTexCoord")
        coordinates.location = (-720, 0)
        mapping = nodes.new("ShaderNodeMapping")
        mapping.name, mapping.label, mapping.location = MAPPING, "Turns the environment", (-520, 0)
        # A point's coordinates are turned, hence the picture the other way: as the artist sees it.
        mapping.vector_type = "TEXTURE"
        mapping.inputs["Rotation"].default_value[2] = rotation
        node = nodes.new("ShaderNodeTexEnvironment")
        node.name, node.label, node.location = "FIPT Environment", "Seen outside the room", (-320, 0)
        node.image, node.projection = image, "EQUIRECTANGULAR"
        links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
        links.new(mapping.outputs["Vector"], node.inputs["Vector"])
        links.new(node.outputs["Color"], background.inputs["Color"])
        if hasattr(world, "cycles"):  # Cycles' automatic choice is 4096, seconds before every render
            world.cycles.sampling_method = "MANUAL"
            world.cycles.sample_map_resolution = max(2 * image.size[0], 64)
    refresh_world(scene)
    return world


def show_original_world(scene: bpy.types.Scene, on: bool) -> None:
    """Show the world that the scene had before ours, or ours again; without ours do nothing."""
    if on and OWN_WORLD not in scene and own_world(scene) is not None:
        scene[OWN_WORLD] = scene.world
        scene.world = scene.get(ORIGINAL_WORLD)
    elif not on and OWN_WORLD in scene:
        if scene.world is not None:
            scene[ORIGINAL_WORLD] = scene.world
        elif ORIGINAL_WORLD in scene:
            del scene[ORIGINAL_WORLD]
        scene.world = scene[OWN_WORLD]
        del scene[OWN_WORLD]


def restore_world(scene: bpy.types.Scene) -> None:
    """Bring back the world that the scene had before `apply_environment`, and remove ours."""
    world = own_world(scene)
    if world is None:
        return
    show_original_world(scene, True)
    for key in (ORIGINAL_WORLD, OWN_WORLD):
        if key in scene:
            del scene[key]
    if world.users == 0:
        node = world.node_tree.nodes.get("FIPT Environment")
        images = [] if node is None or node.image is None else [node.image]
        bpy.data.worlds.remove(world)
        remove_unused_images(images)
