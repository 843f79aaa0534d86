"""One tree of collections for the room, whatever their names; selecting and removing objects."""

from __future__ import annotations

import bpy

from .marks import COLLECTION

# Marks of the collections, and their names in new scenes.
TREE = "FIPT"
ROOM = "FIPT Room"
CAMERAS = "FIPT Cameras"
FIXTURES = "FIPT Fixtures"
LIGHTS = "FIPT Lights"
INSERTED = "FIPT Inserted"
EARLIER_ROOMS = "FIPT Earlier Rooms"
EMPTIED = "FIPT Emptied"
NAMES = {
    TREE: "Room",
    ROOM: "Parts",
    CAMERAS: "Photographs",
    FIXTURES: "Lamps",
    LIGHTS: "Added Lights",
    INSERTED: "Inserted",
    EARLIER_ROOMS: "Earlier Rooms",
    EMPTIED: "Behind Removed",
}


def find_collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection | None:
    """The scene's collection with that mark."""
    children = scene.collection.children_recursive
    return next((child for child in children if child.get(COLLECTION) == name), None)


def collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    """The scene's collection with that mark (`find_collection`); made in the tree if it is missing."""
    existing = find_collection(scene, name)
    if existing is not None:
        return existing
    new = bpy.data.collections.new(NAMES[name])
    new[COLLECTION] = name
    parent = scene.collection if name == TREE else collection(scene, TREE)
    parent.children.link(new)
    return new


def remove_if_empty(scene: bpy.types.Scene, name: str) -> None:
    """Remove a collection of ours that holds nothing, and the tree if it was the last one there."""
    found = find_collection(scene, name)
    if found is not None and not found.all_objects and not found.children:
        bpy.data.collections.remove(found)
        if name != TREE:
            remove_if_empty(scene, TREE)


def move_to(item: bpy.types.Object, target: bpy.types.Collection) -> None:
    """Make `target` the only collection of an object."""
    for other in list(item.users_collection):
        if other != target:
            other.objects.unlink(item)
    if item.name not in target.objects:
        target.objects.link(item)


def select_only(layer: bpy.types.ViewLayer, item: bpy.types.Object) -> None:
    """Select one object of a view layer and make it active, if it is there; deselect all others."""
    layer.update()  # a new object is not among the layer's objects before
    for selected in list(layer.objects.selected):
        selected.select_set(False, view_layer=layer)
    if item.name in layer.objects:
        item.select_set(True, view_layer=layer)
        layer.objects.active = item


def remove_object(item: bpy.types.Object) -> None:
    """Remove an object, and its data if nothing else uses it."""
    data = item.data
    bpy.data.objects.remove(item)
    if data is not None and data.users == 0:
        bpy.data.batch_remove([data])
