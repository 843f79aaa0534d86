# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of materials, lights and the world in linear Rec.709, which readers of exported files expect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext

import bpy
import numpy as np

from ..color_spaces import from_scene_linear, scene_matrix


@contextmanager
def colors_in_rec709(scene: bpy.types.Scene, is_usd: bool) -> Iterator[None]:
    """For the length of a block, give what a scene's objects and world use the numbers of linear Rec.709.

    Blender's exporters write numbers as they are. Nothing happens where scene-linear is Rec.709.

    Args:
        scene: the scene that is exported.
        is_usd: whether the file is USD, in which newer versions of Blender name the working space. They keep
            that while images have unsaved changes: colours then stay in the space that is named.
    """
    if np.array_equal(scene_matrix(), np.eye(3)) or (is_usd and _names_space() and not _can_switch()):
        yield
        return
    materials = {slot.material for item in scene.objects for slot in item.material_slots}
    lights = {item.data for item in scene.objects if item.type == "LIGHT"}
    with ExitStack() as stack:
        for light in lights:
            color = _rec709(light.color)
            strength = max(*color, 1e-9)  # glTF's colours end at 1
            _set(stack, light, "energy", light.energy * strength)
            _set(stack, light, "color", [value / strength for value in color])
        for block in (materials | lights | {scene.world}) - {None}:
            for socket in _colors(block):
                red, green, blue, alpha = socket.default_value
                if red == green == blue:
                    continue
                color = _rec709((red, green, blue))
                if socket.name == "Base Color":
                    color = [min(value, 1.0) for value in color]
                _set(stack, socket, "default_value", [*color, alpha])
        with _working_in_rec709() if is_usd and _names_space() else nullcontext():
            yield


def _colors(block: bpy.types.Material | bpy.types.Light | bpy.types.World) -> list[bpy.types.NodeSocket]:
    """The colours in the nodes of a data-block."""
    nodes = [] if block.node_tree is None or not block.is_editable else block.node_tree.nodes
    inputs = [socket for node in nodes for socket in node.inputs if socket.type == "RGBA"]
    constants = [node.outputs[0] for node in nodes if node.bl_idname == "ShaderNodeRGB"]
    return inputs + constants


def _rec709(color: Sequence[float]) -> list[float]:
    return [max(value, 0.0) for value in from_scene_linear(tuple(color)).tolist()]


def _set(stack: ExitStack, owner: bpy.types.bpy_struct, name: str, value: float | list[float]) -> None:
    kept = getattr(owner, name)
    stack.callback(setattr, owner, name, tuple(kept) if hasattr(kept, "__len__") else kept)
    setattr(owner, name, value)


def _names_space() -> bool:
    """Whether Blender's exporter of USD names the working space."""
    return bool(getattr(getattr(bpy.data, "colorspace", None), "working_space_interop_id", ""))


def _can_switch() -> bool:
    """Whether the file's working space can be exchanged without touching any data."""
    return not any(image.is_dirty for image in bpy.data.images)


@contextmanager
def _working_in_rec709() -> Iterator[None]:
    """Let USD files name Rec.709 as the space of their colours."""
    before = bpy.data.colorspace.working_space
    switch = bpy.ops.wm.set_working_color_space
    switch(working_space="Linear Rec.709", convert_colors=False)
    try:
        yield
    finally:
        switch(working_space=before, convert_colors=False)
