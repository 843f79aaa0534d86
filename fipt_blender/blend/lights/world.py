"""The estimated environment as the scene's world, black where the run has none."""

from __future__ import annotations

import bpy

from ...core.run.documents import read_document
from ...core.run.result_contents import Emitters
from ...core.run.runfolder import RunFolder
from ..image_datablocks import remove_unused_images
from ..marks import BACKGROUND, MAPPING, ORIGINAL_WORLD, RESULT_WORLD, UNIT, WORLD, remove_marks, result_world
from ..node_trees import node_tree
from ..texture_files import TextureFiles, in_run_folder
from .calibration import scene_unit
from .light_state import refresh_world

NAME = "FIPT World"
ENVIRONMENT = "FIPT Environment"  # texture node


def apply_environment(
    run: RunFolder, scene: bpy.types.Scene | None = None, files: TextureFiles | None = None
) -> bpy.types.World | None:
    """Give the scene a world with the run's environment map, or a black one.

    The scene's original world is kept in a custom property; `restore_world` restores it. The settings of an
    earlier world of ours are kept.

    Args:
        run: the run folder; results/emitters.json and the image that it names are read.
        scene: the context's by default.
        files: where the image is kept; in the run folder by default.

    Returns:
        The world; None where the artist has chosen another one since results were applied, which stays.
    """
    scene = scene or bpy.context.scene
    world = result_world(scene)
    if world is None and hasattr(scene, "fipt") and scene.fipt.materials.object_count:
        return None
    environment = read_document(run.emitters_json, Emitters, "Run the estimation again.").environment
    image = None
    if environment:
        files = files or in_run_folder(run)
        files.copy(run.results / environment.image)
        image = files.load(run.results / environment.image, is_data=None)
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
    world[WORLD], world[UNIT] = int(image is not None), scene_unit(scene)
    tree = node_tree(world)
    nodes, links = tree.nodes, tree.links
    earlier = _images(world)
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
        # "Texture" inverts the mapping, so that the picture itself rotates as the artist enters it.
        mapping.vector_type = "TEXTURE"
        mapping.inputs["Rotation"].default_value[2] = rotation
        node = nodes.new("ShaderNodeTexEnvironment")
        node.name, node.label, node.location = ENVIRONMENT, "Seen outside the room", (-320, 0)
        node.image, node.projection = image, "EQUIRECTANGULAR"
        links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
        links.new(mapping.outputs["Vector"], node.inputs["Vector"])
        links.new(node.outputs["Color"], background.inputs["Color"])
        if hasattr(world, "cycles"):  # Cycles' default of 4096 takes seconds before every render
            world.cycles.sampling_method = "MANUAL"
            world.cycles.sample_map_resolution = max(2 * image.size[0], 64)
    remove_unused_images(earlier)
    if image is not None:
        image.name = NAME
    refresh_world(scene)
    return world


def _images(world: bpy.types.World) -> set[bpy.types.Image]:
    """The image of our world's environment, if there is one."""
    node = world.node_tree.nodes.get(ENVIRONMENT)
    return set() if node is None or node.image is None else {node.image}


def show_original_world(scene: bpy.types.Scene, on: bool) -> None:
    """Show the scene's original world, or ours again; nothing happens without a world of ours."""
    if on and RESULT_WORLD not in scene and result_world(scene) is not None:
        scene[RESULT_WORLD] = scene.world
        scene.world = scene.get(ORIGINAL_WORLD)
    elif not on and RESULT_WORLD in scene:
        if scene.world is not None:
            scene[ORIGINAL_WORLD] = scene.world
        else:
            remove_marks(scene, ORIGINAL_WORLD)
        scene.world = scene[RESULT_WORLD]
        remove_marks(scene, RESULT_WORLD)


def restore_world(scene: bpy.types.Scene) -> None:
    """Restore the world that the scene had before `apply_environment`, and remove ours."""
    world = result_world(scene)
    if world is None:
        return
    show_original_world(scene, True)
    remove_marks(scene, ORIGINAL_WORLD, RESULT_WORLD)
    if world.users == 0:
        images = _images(world)
        bpy.data.worlds.remove(world)
        remove_unused_images(images)
