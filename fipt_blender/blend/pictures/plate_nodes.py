# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A composite's layers as nodes of Blender's compositor, in a scene of their own: the room's F12 stays."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.run.errors import FiptError
from ..marks import COMPOSITING, PLATE_NODES
from .layered_exr import read_size

GROUP, SCENE = "FIPT Plate Composite", "FIPT Composite"
_IMAGE = "FIPT Layers"  # the node that reads the file
LAYERS = ("plate", "shadow", "light", "object")


def make_plate_scene(scene: bpy.types.Scene, path: Path) -> bpy.types.Scene:
    """The scene that composites the layers of a file; one that we made before gets the new file.

    Args:
        scene: the room's, whose colour management it gets.
        path: EXR of `layered_exr` with `LAYERS` and "depth".

    Raises:
        FiptError: ``picture-missing``; ``picture-layers`` for another file.
    """
    if not path.is_file():
        raise FiptError("picture-missing", f"{path} no longer exists.", "Render the picture again.")
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    group = next((tree for tree in bpy.data.node_groups if PLATE_NODES in tree), None)
    if group is None:
        group = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    try:
        _fill(group, image)
    except KeyError:
        bpy.data.node_groups.remove(group)
        raise FiptError(
            "picture-layers",
            f"{path.name} has no layers of a composite.",
            "Choose Photograph and use Final Picture first.",
        ) from None
    group[PLATE_NODES] = 1
    made = next((each for each in bpy.data.scenes if COMPOSITING in each), None)
    if made is None:
        made = bpy.data.scenes.new(SCENE)
        made[COMPOSITING] = 1
        _show(made, group)
    made.render.resolution_x, made.render.resolution_y = read_size(path)
    made.render.resolution_percentage = 100
    for name in ("view_transform", "look", "exposure", "gamma"):
        setattr(made.view_settings, name, getattr(scene.view_settings, name))
    return made


def _fill(group: bpy.types.NodeTree, image: bpy.types.Image) -> None:
    """Nodes that composite the layers: object over plate x shadow, plus light. KeyError for other images."""
    nodes, links = group.nodes, group.links
    source = nodes.get(_IMAGE)
    is_new = source is None
    if is_new:
        source = nodes.new("CompositorNodeImage")
        source.name = source.label = _IMAGE
    source.image = image
    plate, shadow, light, added = (source.outputs[name] for name in LAYERS)
    depth = source.outputs["depth"]
    if not is_new:  # the rest is as we or the artist left it
        return
    darkened = _mix(group, "MULTIPLY", plate, shadow, (300, 0))
    over = nodes.new("CompositorNodeAlphaOver")
    over.location = (500, 0)
    named = {socket.name: socket for socket in over.inputs}
    below, above = (
        (named["Background"], named["Foreground"])
        if "Foreground" in named
        else (over.inputs[1], over.inputs[2])
    )
    links.new(darkened, below)
    links.new(added, above)
    picture = _mix(group, "ADD", over.outputs[0], light, (700, 0))
    output = nodes.new("NodeGroupOutput")
    output.location = (900, 0)
    shown = {
        "Image": picture,
        "Plate": plate,
        "Shadow": shadow,
        "Light": light,
        "Object": added,
        "Depth": depth,
    }
    for name, socket in shown.items():
        kind = "NodeSocketFloat" if name == "Depth" else "NodeSocketColor"
        group.interface.new_socket(name, in_out="OUTPUT", socket_type=kind)
        links.new(socket, output.inputs[name])


def _mix(
    group: bpy.types.NodeTree,
    blend: str,
    first: bpy.types.NodeSocket,
    second: bpy.types.NodeSocket,
    location: tuple[int, int],
) -> bpy.types.NodeSocket:
    """The output of a node that blends two colours in full."""
    try:
        node = group.nodes.new("CompositorNodeMixRGB")
        inputs, output = node.inputs[1:3], node.outputs[0]
    except RuntimeError:  # from Blender 5.0
        node = group.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        inputs = [socket for socket in node.inputs if socket.enabled and socket.type == "RGBA"]
        output = next(socket for socket in node.outputs if socket.enabled)
    node.blend_type, node.location = blend, location
    node.inputs[0].default_value = 1.0
    group.links.new(first, inputs[0])
    group.links.new(second, inputs[1])
    return output


def _show(scene: bpy.types.Scene, group: bpy.types.NodeTree) -> None:
    """Make a node group what a new scene renders."""
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = group
        return
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = group
    for kind, x in (("CompositorNodeComposite", 300), ("CompositorNodeViewer", 300)):
        output = tree.nodes.new(kind)
        output.location = (x, 0 if kind.endswith("Composite") else -200)
        tree.links.new(node.outputs["Image"], output.inputs["Image"])
