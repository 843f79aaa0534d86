"""Inserted objects over a photograph, the plate: Cycles' shadow catcher, put together by compositor nodes.

The nodes are in a copy of the scene: picture = object + (1 - alpha of the object) plate catcher. The pass
Shadow Catcher is the ratio of the room with and without the objects, so it has their shadows and their light.
"""

from __future__ import annotations

import bpy

from ...core.run.contents import CapturedView
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..capture.backdrop import set_backdrop
from ..export.stage import rendered_objects
from ..image_datablocks import load_radiance
from ..lights.convert import RAYS
from ..lights.fixture_nodes import emission_material, is_emission_material, surfaces
from ..lights.tint import unit_of
from ..marks import (
    BACKGROUND,
    BASE,
    FIXTURE,
    FIXTURE_SOURCES,
    MAPPING,
    PLATE,
    VISIBILITY,
    WORLD,
    fixture_lights,
    fixtures_of,
    remove_marks,
    result_world,
)
from ..render_settings import can_denoise
from ..results.scene_state import median_radiance, median_shown, photograph_exposures
from .renders import plate_size

SCENE = "FIPT Composite"
# Pixels over which the change of the shadow catcher is averaged, and the mean up to which it is noise: for
# wide, faint shadows and for small, dark ones. From twice that on it is shown in full. The denoiser changes a
# constant by less than 1 %, but by 12 % at edges.
_UNCHANGED = ((12, 0.02), (4, 0.1))


def plate_scene(scene: bpy.types.Scene, run: RunFolder, view: CapturedView) -> bpy.types.Scene:
    """A copy of a scene, with the same objects, that renders them over the photograph of its camera's view.

    Its lamps and its world are copies that shine as photographed, whatever the artist has changed since: the
    surfaces of lamps, not Blender lights that stand for them.

    Args:
        scene: the room's.
        run: the run folder.
        view: the view.
    """
    path = run.resolve(view.image)
    image = load_radiance(path, view.encoded)
    if image is None or min(image.size) == 0:
        raise FiptError("image-missing.photograph", path=path, name=view.name)
    set_backdrop(scene, "PHOTOGRAPH", scene.fipt.capture.room_objects(scene))  # also objects that came since
    size, rendered = plate_size(scene, scene.camera), rendered_objects(scene)
    made = scene.copy()
    made.name = SCENE
    render, root = made.render, made.collection
    render.engine, render.film_transparent, render.resolution_percentage = "CYCLES", True, 100
    render.resolution_x, render.resolution_y = size
    render.use_border, render.use_sequencer, render.use_compositing = False, False, True
    for group in list(root.children):
        root.children.unlink(group)
    for item in list(root.objects):
        root.objects.unlink(item)
    fixtures = [item for item in fixtures_of(scene) if BASE in item]
    replaced = set(fixtures).union(*map(fixture_lights, fixtures))
    for item in [each for each in rendered if each not in replaced] + [
        _as_photographed(each) for each in fixtures
    ]:
        root.objects.link(item)
    if (world := result_world(scene)) is not None:
        made.world = _world_as_photographed(world)
    layer = next((each for each in made.view_layers if each.use), made.view_layers[0])
    for each in made.view_layers:
        each.use = each == layer
    layer.use_pass_combined, layer.use_pass_z, layer.cycles.use_pass_shadow_catcher = True, True, True
    _add_nodes(made, layer, image, plate_gain(run, view) if view.encoded else 1.0)
    return made


def remove_plate_scene(scene: bpy.types.Scene) -> None:
    """Remove what `plate_scene` made."""
    tree, world = getattr(scene, "compositing_node_group", None), scene.world
    copies = [item for item in scene.objects if PLATE in item]
    meshes = [item.data for item in copies]
    materials = {material for mesh in meshes for material in mesh.materials if material and PLATE in material}
    bpy.data.scenes.remove(scene)
    made = [tree, world if world is not None and PLATE in world else None, *copies, *meshes, *materials]
    bpy.data.batch_remove([block for block in made if block is not None])


def plate_gain(run: RunFolder, view: CapturedView) -> float:
    """Radiance of the renders for a value of 1 of a photograph that is not HDR: its exposure is its own.

    By what the estimation has found of the photographs' exposures, in stops from the median photograph's.
    """
    stops = photograph_exposures(run).get(view.name, 0.0)
    return (median_radiance(run) or median_shown(run)) / median_shown(run) * 2.0**-stops


def _as_photographed(fixture: bpy.types.Object) -> bpy.types.Object:
    """A copy of a fixture whose surfaces have the estimated radiance."""
    item = fixture.copy()
    item.data = fixture.data.copy()
    remove_marks(item, FIXTURE, FIXTURE_SOURCES, VISIBILITY)
    item[PLATE], item.hide_render, item.is_shadow_catcher = True, False, True
    for name in ("visible_camera", *RAYS):
        setattr(item, name, True)
    unit = unit_of(fixture)
    for each in surfaces(fixture):
        if is_emission_material(each.material):
            sides = ([unit * value for value in side] for side in (each.front, each.back))
            item.data.materials[each.slot] = material = emission_material(each.material.name, *sides)
            material[PLATE] = True
    return item


def _world_as_photographed(world: bpy.types.World) -> bpy.types.World:
    """A copy of our world as estimated."""
    made = world.copy()
    made[PLATE] = True
    nodes = made.node_tree.nodes
    if BACKGROUND in nodes:
        nodes[BACKGROUND].inputs["Strength"].default_value = unit_of(world) if world[WORLD] else 0.0
    if MAPPING in nodes:
        nodes[MAPPING].inputs["Rotation"].default_value = (0.0, 0.0, 0.0)
    return made


def _add_nodes(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, image: bpy.types.Image, gain: float
) -> None:
    """Make the plate, times the shadow catcher, with the objects over it, what a scene renders."""
    if hasattr(scene, "compositing_node_group"):  # from Blender 5.0
        tree = scene.compositing_node_group = bpy.data.node_groups.new(SCENE, "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    nodes, links = tree.nodes, tree.links
    rendered, plate = nodes.new("CompositorNodeRLayers"), nodes.new("CompositorNodeImage")
    rendered.scene, rendered.layer, plate.image = scene, layer.name, image
    noisy = shown = rendered.outputs["Shadow Catcher"]
    if scene.cycles.use_denoising and can_denoise():
        noisy, denoise = rendered.outputs["Noisy Shadow Catcher"], nodes.new("CompositorNodeDenoise")
        links.new(noisy, denoise.inputs["Image"])
        shown = denoise.outputs[0]
    catcher = _caught(tree, noisy, shown)
    scaled = nodes.new("CompositorNodeScale")
    if "Type" in scaled.inputs:  # from Blender 5.0
        scaled.inputs["Type"].default_value = "Render Size"
    else:
        scaled.space = "RENDER_SIZE"
    links.new(plate.outputs["Image"], scaled.inputs["Image"])
    caught = _blend(tree, "MULTIPLY", scaled.outputs[0], catcher)
    if gain != 1.0:
        caught = _blend(tree, "MULTIPLY", caught, (gain, gain, gain, 1.0))
    over = nodes.new("CompositorNodeAlphaOver")
    named = {socket.name: socket for socket in over.inputs}
    below = named["Background"] if "Background" in named else over.inputs[1]
    above = named["Foreground"] if "Foreground" in named else over.inputs[2]
    links.new(caught, below)
    links.new(rendered.outputs["Image"], above)
    links.new(over.outputs[0], output.inputs["Image"])
    for place, node in enumerate(nodes):
        node.location = (250 * (place // 2), -450 * (place % 2))


def _caught(
    tree: bpy.types.NodeTree, noisy: bpy.types.NodeSocket, shown: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """The shadow catcher where the mean of its noise tells of a change by the objects; elsewhere exactly 1.

    Args:
        tree: gets the nodes.
        noisy: the pass as rendered.
        shown: the pass that is shown where it changes something.
    """
    ones, most = (1.0, 1.0, 1.0, 1.0), (2.0, 2.0, 2.0, 1.0)
    change = _blend(tree, "SUBTRACT", _blend(tree, "DARKEN", noisy, most), ones)
    sizes = []
    for pixels, limit in _UNCHANGED:
        blur = tree.nodes.new("CompositorNodeBlur")
        tree.links.new(change, blur.inputs["Image"])
        if blur.inputs["Size"].type == "VECTOR":  # from Blender 4.5
            blur.inputs["Size"].default_value[:2] = pixels, pixels
        else:
            blur.size_x = blur.size_y = pixels
        size = _blend(tree, "DIFFERENCE", blur.outputs[0], (0.0, 0.0, 0.0, 1.0))
        sizes.append(_blend(tree, "MULTIPLY", size, (1.0 / limit,) * 3 + (1.0,)))
    changed = _blend(tree, "SUBTRACT", _blend(tree, "LIGHTEN", *sizes), ones)
    node = changed.node
    setattr(node, "use_clamp" if hasattr(node, "use_clamp") else "clamp_result", True)
    unchanged = _blend(tree, "DIFFERENCE", changed, ones)
    return _blend(tree, "MIX", shown, ones, unchanged)


def _blend(
    tree: bpy.types.NodeTree,
    blend: str,
    first: bpy.types.NodeSocket,
    second: bpy.types.NodeSocket | tuple[float, ...],
    factor: bpy.types.NodeSocket | None = None,
) -> bpy.types.NodeSocket:
    """The output of a node that blends two colours, in full without a factor."""
    try:
        node = tree.nodes.new("CompositorNodeMixRGB")
        inputs, output = node.inputs[1:3], node.outputs[0]
    except RuntimeError:  # from Blender 5.0
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        inputs = [socket for socket in node.inputs if socket.enabled and socket.type == "RGBA"]
        output = next(socket for socket in node.outputs if socket.enabled)
    node.blend_type = blend
    node.inputs[0].default_value = 1.0
    if factor is not None:
        tree.links.new(factor, node.inputs[0])
    tree.links.new(first, inputs[0])
    if isinstance(second, tuple):
        inputs[1].default_value = second
    else:
        tree.links.new(second, inputs[1])
    return output
