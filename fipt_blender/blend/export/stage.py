"""A scene of what renders show, in which plain things stand for those that exporters do not understand."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import bpy

# Settings of modifiers that differ between viewport and render.
_RENDERED = {"show_viewport": "show_render", "levels": "render_levels", "steps": "render_steps"}


def rendered_objects(
    scene: bpy.types.Scene, layers: Sequence[bpy.types.ViewLayer] = ()
) -> list[bpy.types.Object]:
    """The objects that renders of a scene show: in one of these view layers, by default those that render,
    hidden neither themselves nor by all their collections."""
    found: dict[bpy.types.Object, None] = {}

    def visit(layer: bpy.types.LayerCollection) -> None:
        if layer.exclude or layer.collection.hide_render:
            return
        found.update(dict.fromkeys(item for item in layer.collection.objects if not item.hide_render))
        for child in layer.children:
            visit(child)

    for view_layer in layers or [each for each in scene.view_layers if each.use]:
        visit(view_layer.layer_collection)
    return list(found)


class Stage:
    """A scene of its own, shown in the window. At its end all is as it was, and what was made is removed."""

    def __enter__(self) -> Stage:
        self._made: list[bpy.types.ID] = []
        self._kept: set[bpy.types.ID] = set()
        self.renamed: dict[bpy.types.ID, str] = {}
        self.undo = ExitStack()
        self.scene = bpy.data.scenes.new("FIPT Export")
        self.set(bpy.context.window, "scene", self.scene)
        return self

    def __exit__(self, *_: object) -> None:
        self.undo.close()
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove(self._made)
        for block, name in self.renamed.items():
            block.name = name

    def set(self, owner: bpy.types.bpy_struct, name: str, value: Any) -> None:
        """Set a property until the end."""
        before = getattr(owner, name)
        before = tuple(before) if isinstance(value, tuple) else before
        if before != value:
            self.undo.callback(setattr, owner, name, before)
            setattr(owner, name, value)

    def show(self, item: bpy.types.Object) -> None:
        """Put an object on the stage as renders show it, with its parents."""
        if item.name in self.scene.collection.objects:
            return
        if item.parent is not None:
            self.show(item.parent)
        self.scene.collection.objects.link(item)
        self.set(item, "hide_viewport", False)
        for modifier in item.modifiers:
            for viewport, render in _RENDERED.items():
                if hasattr(modifier, render):
                    self.set(modifier, viewport, getattr(modifier, render))
        self.keep_names(item)

    def hide_others(self) -> None:
        """Hide children of the stage's objects that are elsewhere: exporters follow them there."""
        for item in list(self.scene.objects):
            for child in set(item.children_recursive) - set(self.scene.objects):
                self.set(child, "hide_render", True)

    def keep_names(self, *blocks: bpy.types.ID) -> None:
        """Datablocks of the artist's that are exported themselves."""
        self._kept |= set(blocks)

    def replace(self, material: bpy.types.Material, other: bpy.types.Material, name: str) -> None:
        """Let a new material stand for another one wherever that is used."""
        self.add(other, name)
        material.user_remap(other)
        self.undo.callback(other.user_remap, material)

    def add_light(self, name: str, light: bpy.types.Light, matrix: Any) -> None:
        """A new light of a name on the stage."""
        item = self.add(bpy.data.objects.new(name, self.add(light, name)), name)
        item.matrix_world = matrix
        self.scene.collection.objects.link(item)

    def add(self, block: bpy.types.ID, name: str) -> Any:
        """Remove a new datablock at the end, and let it have a name until then.

        A datablock of the artist that has the name steps aside. Where another one that is exported has it,
        this one is numbered: "Wall 2".
        """
        others, free, number = _blocks(block), name, 1
        while (holder := others.get((free, None))) is not None and holder in {*self._kept, *self._made}:
            number += 1
            free = f"{name} {number}"
        if holder is not None and holder != block:
            holder.name = f".fipt_aside_{len(self.renamed)}"
            self.renamed[holder] = free
        self._made.append(block)
        block.name = free
        return block

    def name(self, block: bpy.types.ID) -> str:
        """The name that the artist gave to a datablock, which may have stepped aside."""
        return self.renamed.get(block, block.name)


def _blocks(block: bpy.types.ID) -> bpy.types.bpy_prop_collection:
    kinds = {
        bpy.types.Object: bpy.data.objects,
        bpy.types.Mesh: bpy.data.meshes,
        bpy.types.Material: bpy.data.materials,
        bpy.types.Light: bpy.data.lights,
        bpy.types.World: bpy.data.worlds,
        bpy.types.Image: bpy.data.images,
    }
    return next(blocks for kind, blocks in kinds.items() if isinstance(block, kind))
