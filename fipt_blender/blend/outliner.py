# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's collections that hold what we make, each under a name an artist recognises."""

from __future__ import annotations

import bpy

ROOM = "FIPT Room"
CAMERAS = "FIPT Cameras"
FIXTURES = "FIPT Fixtures"
LIGHTS = "FIPT Lights"


def find_collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection | None:
    """The scene's collection of that name; where a file has several ("name.001"), the scene's own."""
    for child in scene.collection.children_recursive:
        if child.name == name or (child.name[:-4] == name and child.name[-4:-3] == "."):
            return child
    return None


def collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    """The same, made and linked where it is missing."""
    found = find_collection(scene, name)
    if found is not None:
        return found
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


def select_only(layer: bpy.types.ViewLayer, item: bpy.types.Object) -> None:
    """Deselect everything in a view layer and make one object, if it is there, selected and active."""
    for each in list(layer.objects.selected):
        each.select_set(False, view_layer=layer)
    if item.name in layer.objects:
        item.select_set(True, view_layer=layer)
        layer.objects.active = item
