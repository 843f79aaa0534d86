# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimated environment as the scene's world; black where there is none."""

from __future__ import annotations

import bpy

from ..core.job.runfolder import RunFolder, read_json
from .images import load_texture

WORLD = "FIPT World"
ORIGINAL_WORLD = "fipt_original_world"
STRENGTH = "fipt_strength"


def apply_environment(run: RunFolder, scene: bpy.types.Scene | None = None) -> bpy.types.World:
    """Give the scene a world with the run's environment map, or a black one.

    The scene's own world is kept in a custom property; `restore_world` brings it back.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    scene = scene or bpy.context.scene
    world = bpy.data.worlds.get(WORLD) or bpy.data.worlds.new(WORLD)
    if world.node_tree is None:
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputWorld")
    output.location = (300, 0)
    background = nodes.new("ShaderNodeBackground")
    background.name = "FIPT Background"
    background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    links.new(background.outputs["Background"], output.inputs["Surface"])
    environment = read_json(run.emitters_json).get("environment")
    background.inputs["Strength"].default_value = 1.0 if environment else 0.0
    if environment:
        node = nodes.new("ShaderNodeTexEnvironment")
        node.name, node.label, node.location = "FIPT Environment", "Seen outside the room", (-320, 0)
        node.image = load_texture(run.results / environment["image"], is_data=False)
        node.projection = "EQUIRECTANGULAR"
        links.new(node.outputs["Color"], background.inputs["Color"])
        if hasattr(world, "cycles"):  # Cycles' automatic choice is 4096, seconds before every render
            world.cycles.sampling_method = "MANUAL"
            world.cycles.sample_map_resolution = max(2 * node.image.size[0], 64)
    world[STRENGTH] = background.inputs["Strength"].default_value
    if scene.world is not None and scene.world != world:
        scene[ORIGINAL_WORLD] = scene.world
    scene.world = world
    return world


def set_environment_enabled(on: bool) -> None:
    """Switch the estimated environment; does nothing where there is none."""
    world = bpy.data.worlds.get(WORLD)
    if world is not None:
        strength = world.node_tree.nodes["FIPT Background"].inputs["Strength"]
        strength.default_value = world[STRENGTH] if on else 0.0


def restore_world(scene: bpy.types.Scene) -> None:
    """Bring back the world that the scene had before `apply_environment`."""
    if ORIGINAL_WORLD in scene:
        scene.world = scene[ORIGINAL_WORLD]
        del scene[ORIGINAL_WORLD]
