# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's collections that hold what we make, each under a name an artist recognises."""

from __future__ import annotations

import bpy

ROOM = "FIPT Room"
CAMERAS = "FIPT Cameras"
FIXTURES = "FIPT Fixtures"
LIGHTS = "FIPT Lights"


def collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    """The scene's collection of that name, made and linked where it is missing."""
    for child in scene.collection.children_recursive:
        if child.name == name:
            return child
    new = bpy.data.collections.new(name)
    scene.collection.children.link(new)
    return new


def move_to(item: bpy.types.Object, target: bpy.types.Collection) -> None:
    """Make `target` the only collection of an object."""
    for other in list(item.users_collection):
        if other != target:
            other.objects.unlink(item)
    if item.name not in target.objects:
        target.objects.link(item)
