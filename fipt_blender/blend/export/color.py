"""Colours of materials, lights and the world in linear Rec.709, which readers of exported files expect."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import bpy
import numpy as np

from ..color_spaces import from_scene_linear, scene_matrix
from .stage import Stage


def colors_in_rec709(stage: Stage, is_usd: bool) -> None:
    """Give what a stage's objects and world use the numbers of linear Rec.709, until the stage's end.

    Blender's exporters write numbers as they are. Nothing happens where scene-linear is Rec.709.

    Args:
        stage: what is exported.
        is_usd: whether the file is USD, in which newer versions of Blender name the working space. They keep
            that while images have unsaved changes: colours then stay in the space that is named.
    """
    if np.array_equal(scene_matrix(), np.eye(3)) or (is_usd and _names_space() and not _can_switch()):
        return
    scene = stage.scene
    materials = {slot.material for item in scene.objects for slot in item.material_slots}
    lights = {item.data for item in scene.objects if item.type == "LIGHT"}
    for light in lights:
        color = _rec709(light.color)
        strength = max(*color, 1e-9)  # glTF's colours end at 1
        stage.set(light, "energy", light.energy * strength)
        stage.set(light, "color", tuple(value / strength for value in color))
    for block in (materials | lights | {scene.world}) - {None}:
        for socket in _colors(block):
            red, green, blue, alpha = socket.default_value
            if red == green == blue:
                continue
            color = _rec709((red, green, blue))
            if socket.name == "Base Color":
                color = [min(value, 1.0) for value in color]
            stage.set(socket, "default_value", (*color, alpha))
    if is_usd and _names_space():  # the file names Rec.709 as the space of its colours
        switch = partial(bpy.ops.wm.set_working_color_space, convert_colors=False)
        stage.undo.callback(switch, working_space=bpy.data.colorspace.working_space)
        switch(working_space="Linear Rec.709")


def _colors(block: bpy.types.Material | bpy.types.Light | bpy.types.World) -> list[bpy.types.NodeSocket]:
    """The colours in the nodes of a data-block."""
    nodes = [] if block.node_tree is None or not block.is_editable else block.node_tree.nodes
    inputs = [socket for node in nodes for socket in node.inputs if socket.type == "RGBA"]
    constants = [node.outputs[0] for node in nodes if node.bl_idname == "ShaderNodeRGB"]
    return inputs + constants


def _rec709(color: Sequence[float]) -> list[float]:
    return [max(value, 0.0) for value in from_scene_linear(tuple(color)).tolist()]


def _names_space() -> bool:
    """Whether Blender's exporter of USD names the working space."""
    return bool(getattr(getattr(bpy.data, "colorspace", None), "working_space_interop_id", ""))


def _can_switch() -> bool:
    """Whether the file's working space can be exchanged without touching any data."""
    return not any(image.is_dirty for image in bpy.data.images)
