# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights as they were when the room was photographed, whatever the artist has made of them since."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy

from ..properties.lights import BACK, BASE, FIXTURE, MAPPING, WORLD
from .light_state import BACKGROUND, own_world
from .renders import changed


@contextmanager
def lights_as_photographed(scene: bpy.types.Scene) -> Iterator[None]:
    """The estimated radiance on all fixtures and the estimated environment, for a while.

    What is so already is not touched: renders before and after then agree to the last sample.
    """
    with ExitStack() as stack:
        for item in scene.objects:
            if FIXTURE in item and BASE in item:
                stack.enter_context(changed(item, {"hide_render": False}))
                _shine(stack, item)
        world = own_world(scene)
        if world is not None:
            stack.enter_context(changed(scene, {"world": world}))
            nodes = world.node_tree.nodes
            if BACKGROUND in nodes:
                _set(stack, nodes[BACKGROUND].inputs["Strength"], 1.0 if world[WORLD] else 0.0)
            if MAPPING in nodes:
                _set(stack, nodes[MAPPING].inputs["Rotation"], (0.0, 0.0, 0.0))
        yield


def _shine(stack: ExitStack, item: bpy.types.Object) -> None:
    material = item.data.materials[0] if item.data.materials else None
    if material is None or material.node_tree is None:
        return
    for name, key in (("FIPT Front", BASE), ("FIPT Back", BACK)):
        node = material.node_tree.nodes.get(name)
        if node is not None:
            _emit(stack, node, [float(value) for value in item.get(key, (0.0, 0.0, 0.0))])
    if hasattr(material, "cycles") and material.cycles.emission_sampling == "NONE":  # lights stand for it
        stack.enter_context(changed(material.cycles, {"emission_sampling": "AUTO"}))


def _emit(stack: ExitStack, node: bpy.types.Node, radiance: Sequence[float]) -> None:
    color, strength = node.inputs["Color"], node.inputs["Strength"]
    now = [color.default_value[channel] * strength.default_value for channel in range(3)]
    if max(abs(a - b) for a, b in zip(now, radiance, strict=True)) <= 1e-5 * max(radiance):
        return
    _set(stack, strength, 1.0)
    _set(stack, color, (*radiance, 1.0))


def _set(stack: ExitStack, socket: bpy.types.NodeSocket, value: Any) -> None:
    kept = socket.default_value
    kept = tuple(kept) if hasattr(kept, "__len__") else kept
    if kept == value:
        return
    stack.callback(setattr, socket, "default_value", kept)
    socket.default_value = value
