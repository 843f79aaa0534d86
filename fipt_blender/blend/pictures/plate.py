# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Inserted objects over a photograph, the plate: Cycles' shadow catcher, put together by compositor nodes.

The nodes are in a copy of the scene: picture = object + (1 - alpha of the object) plate catcher. The pass
Shadow Catcher is the ratio of the room with and without the objects, so it has their shadows and their light.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import AbstractContextManager

import bpy
import numpy as np

from ...core.capture.averaging import means
from ...core.run.contents import CapturedView
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..changed import all_changed
from ..color_spaces import encoded_space
from ..image_datablocks import load_radiance
from ..marks import estimated_objects
from ..render_settings import can_denoise, fitted
from .cycles import RenderOptions, render_pixels
from .image_files import photograph
from .photographed import lights_as_photographed
from .renders import plate_size

SCENE = "FIPT Composite"
# Values by sRGB's curve that say how bright a photograph is: neither clipped nor lost in its darkest codes
_EXPOSED = (0.02, 0.9)
_GAIN_SIDE, _GAIN_SAMPLES = 128, 32  # pixels and samples of the render that a photograph is brought to
# Pixels over which the shadow catcher's change is averaged, and the change from which it is denoised in full:
# the denoiser changes a constant by less than 1 %, and by 12 % within 4 pixels of the picture's edge.
_BLUR, _DENOISED = 4, 0.05
_SHAPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "EMPTY"}


def not_catching(scene: bpy.types.Scene, room: Collection[str]) -> AbstractContextManager[None]:
    """Draw the room whatever the backdrop is, for the length of a block."""
    return all_changed(estimated_objects(scene, room), {"is_shadow_catcher": False})


def catching(scene: bpy.types.Scene, room: Collection[str]) -> AbstractContextManager[None]:
    """Let the room and its lamps catch shadows, for the length of a block."""
    return all_changed(estimated_objects(scene, room), {"is_shadow_catcher": True})


def plate_scene(
    scene: bpy.types.Scene,
    run: RunFolder,
    view: CapturedView,
    camera: bpy.types.Object,
    room: Collection[str],
) -> bpy.types.Scene:
    """A copy of a scene, with the same objects, that renders them over a view's photograph.

    Args:
        scene: the room's.
        run: the run folder.
        view: the view.
        camera: its camera.
        room: names of the room's objects.

    Raises:
        FiptError: ``image-missing``.
    """
    path = run.resolve(view.image)
    image = load_radiance(path)
    if image is None or min(image.size) == 0:
        raise FiptError(
            "image-missing",
            f"The photograph {path} of the view '{view.name}' can't be read.",
            "Put the file back where it was, or import the capture again from where it is now.",
        )
    gain = 1.0
    if view.encoded:
        image.colorspace_settings.name = encoded_space()
        gain = _gain(scene, run, view, camera, room)
    made = scene.copy()
    made.name, made.camera = SCENE, camera
    render = made.render
    render.engine, render.film_transparent, render.resolution_percentage = "CYCLES", True, 100
    render.resolution_x, render.resolution_y = plate_size(scene, camera)
    render.use_border, render.use_sequencer, render.use_compositing = False, False, True
    layer = next((each for each in made.view_layers if each.use), made.view_layers[0])
    for each in made.view_layers:
        each.use = each == layer
    layer.use_pass_combined, layer.use_pass_z, layer.cycles.use_pass_shadow_catcher = True, True, True
    _add_nodes(made, layer, image, gain)
    return made


def remove_plate_scene(scene: bpy.types.Scene) -> None:
    """Remove what `plate_scene` made."""
    tree = getattr(scene, "compositing_node_group", None)
    bpy.data.scenes.remove(scene)
    if tree is not None:
        bpy.data.node_groups.remove(tree)


def _gain(
    scene: bpy.types.Scene,
    run: RunFolder,
    view: CapturedView,
    camera: bpy.types.Object,
    room: Collection[str],
) -> float:
    """Radiance of the renders for a value of 1 of a photograph that is not HDR: its exposure is its own.

    By the median over the pixels of a small render of the room as it was photographed.
    """
    options = RenderOptions(_GAIN_SAMPLES)
    estimated = set(estimated_objects(scene, room))
    added = [item for item in scene.objects if item.type in _SHAPES | {"LIGHT"} and item not in estimated]
    side = fitted((view.width, view.height), _GAIN_SIDE)[0]
    with (
        not_catching(scene, room),
        all_changed(added, {"hide_render": True}),
        lights_as_photographed(scene),
    ):
        rendered = render_pixels(scene, options, camera, side)
    encoded = means(photograph(run, view, smaller=True), rendered.shape[1], rendered.shape[0])
    value, radiance = encoded.mean(axis=-1), rendered.mean(axis=-1)
    used = (encoded.min(axis=-1) > _EXPOSED[0]) & (encoded.max(axis=-1) < _EXPOSED[1]) & (radiance > 0.0)
    return float(np.median(radiance[used] / value[used])) if used.any() else 1.0


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
    catcher = rendered.outputs["Shadow Catcher"]
    if scene.cycles.use_denoising and can_denoise():
        catcher = _denoised(tree, rendered.outputs["Noisy Shadow Catcher"])
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


def _denoised(tree: bpy.types.NodeTree, catcher: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The shadow catcher, denoised where the objects change something: elsewhere it stays exactly 1.

    Cycles denoises the room with and without the objects apart, and their ratio is 1 nowhere.
    """
    denoise, blur = tree.nodes.new("CompositorNodeDenoise"), tree.nodes.new("CompositorNodeBlur")
    tree.links.new(catcher, denoise.inputs["Image"])
    tree.links.new(_blend(tree, "DIFFERENCE", catcher, (1.0, 1.0, 1.0, 1.0)), blur.inputs["Image"])
    if blur.inputs["Size"].type == "VECTOR":  # from Blender 4.5
        blur.inputs["Size"].default_value[:2] = _BLUR, _BLUR
    else:
        blur.size_x = blur.size_y = _BLUR
    factor = _blend(tree, "MULTIPLY", blur.outputs[0], (1.0 / _DENOISED,) * 3 + (1.0,))
    node = factor.node
    setattr(node, "use_clamp" if hasattr(node, "use_clamp") else "clamp_result", True)
    return _blend(tree, "MIX", catcher, denoise.outputs[0], factor)


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
