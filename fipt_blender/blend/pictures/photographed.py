# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights as they were when the room was photographed, whatever the artist has changed since."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

import bpy

from ..changed import all_changed, changed
from ..color_spaces import to_scene_linear
from ..lights.convert import RAYS
from ..lights.fixture_nodes import emitting_sides, surfaces
from ..lights.tint import unit_of
from ..marks import (
    BACKGROUND,
    BACKSIDE,
    BASE,
    FRONT,
    MAPPING,
    WORLD,
    fixture_lights,
    fixtures_of,
    result_world,
)


@contextmanager
def lights_as_photographed(scene: bpy.types.Scene) -> Iterator[None]:
    """Set the estimated radiance of all fixtures and the estimated environment for the length of a block.

    The fixtures' surfaces emit, not Blender lights that stand for them.
    """
    with ExitStack() as stack:
        for item in fixtures_of(scene):
            if BASE in item:
                stack.enter_context(changed(item, {"hide_render": False, "visible_camera": True}))
                _emit_by_surface(stack, item, dict.fromkeys(RAYS, True))
                _emit_as_estimated(stack, item)
        world = result_world(scene)
        if world is not None:
            stack.enter_context(changed(scene, {"world": world}))
            nodes = world.node_tree.nodes
            if BACKGROUND in nodes:
                _set(stack, nodes[BACKGROUND].inputs["Strength"], unit_of(world) if world[WORLD] else 0.0)
            if MAPPING in nodes:
                _set(stack, nodes[MAPPING].inputs["Rotation"], (0.0, 0.0, 0.0))
        yield


def _emit_by_surface(stack: ExitStack, item: bpy.types.Object, visibility: Mapping[str, bool]) -> None:
    """Let a fixture's surface emit in place of its Blender lights, visible to these rays."""
    stack.enter_context(all_changed(fixture_lights(item), {"hide_render": True}))
    stack.enter_context(changed(item, visibility))
    for surface in surfaces(item):
        if hasattr(surface.material, "cycles"):  # not where the Cycles add-on is disabled
            sides = emitting_sides(surface.front, surface.back)
            stack.enter_context(changed(surface.material.cycles, {"emission_sampling": sides}))


def _emit_as_estimated(stack: ExitStack, item: bpy.types.Object) -> None:
    for surface in surfaces(item):
        for name, radiance in ((FRONT, surface.front), (BACKSIDE, surface.back)):
            node = surface.material.node_tree.nodes.get(name)
            if node is not None:
                _set_radiance(stack, node, (unit_of(item) * to_scene_linear(radiance)).tolist())


def _set_radiance(stack: ExitStack, node: bpy.types.Node, radiance: Sequence[float]) -> None:
    color, strength = node.inputs["Color"], node.inputs["Strength"]
    present = [color.default_value[channel] * strength.default_value for channel in range(3)]
    if max(abs(a - b) for a, b in zip(present, radiance, strict=True)) <= 1e-5 * max(radiance):
        return
    _set(stack, strength, 1.0)
    _set(stack, color, (*radiance, 1.0))


def _set(stack: ExitStack, socket: bpy.types.NodeSocket, value: float | tuple[float, ...]) -> None:
    kept = socket.default_value
    kept = tuple(kept) if hasattr(kept, "__len__") else kept
    if kept == value:
        return
    stack.callback(setattr, socket, "default_value", kept)
    socket.default_value = value
