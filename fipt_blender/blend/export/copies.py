# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene of copies that are what renders show, and have the artist's names while they are exported."""

from __future__ import annotations

import bpy
from mathutils import Matrix

# Settings of modifiers that differ between viewport and render.
_RENDERED = {"show_viewport": "show_render", "levels": "render_levels", "steps": "render_steps"}


def rendered_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects that renders of a scene show: in a view layer that renders, hidden neither themselves nor
    by all their collections."""
    found: dict[bpy.types.Object, None] = {}

    def visit(layer: bpy.types.LayerCollection) -> None:
        if layer.exclude or layer.collection.hide_render:
            return
        found.update(dict.fromkeys(item for item in layer.collection.objects if not item.hide_render))
        for child in layer.children:
            visit(child)

    for view_layer in scene.view_layers:
        if view_layer.use:
            visit(view_layer.layer_collection)
    return list(found)


class Copies:
    """A scene of its own; all that was made for it is removed, and all names are restored, at the end."""

    def __init__(self) -> None:
        self._renamed: dict[bpy.types.ID, str] = {}
        self._made: list[bpy.types.ID] = []
        self._kept: set[bpy.types.ID] = set()

    def __enter__(self) -> Copies:
        self.scene = bpy.data.scenes.new("FIPT Export")
        return self

    def __exit__(self, *_: object) -> None:
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove(self._made)
        for block, name in self._renamed.items():
            block.name = name

    def add(
        self, source: bpy.types.Object, data: bpy.types.Mesh | bpy.types.Light | None, matrix: Matrix
    ) -> bpy.types.Object:
        """An object of another's name in the scene, without parent, modifiers and custom properties.

        Readers of USD take the name of the data for the object's, therefore the data has it, too.
        """
        name = self.name(source)
        made: bpy.types.Object = self.keep(bpy.data.objects.new(name, data), name)
        made.matrix_world = matrix
        made.instance_type = source.instance_type if data is None else "NONE"
        self.scene.collection.objects.link(made)
        return made

    def add_light(self, name: str, light: bpy.types.Light, matrix: Matrix) -> None:
        """A light of its own name in the scene."""
        self.keep(light, name)
        made = self.keep(bpy.data.objects.new(name, light), name)
        made.matrix_world = matrix
        self.scene.collection.objects.link(made)

    def keep(self, block: bpy.types.ID, name: str) -> bpy.types.ID:
        """Remove a new datablock at the end, and let it have a name until then.

        A datablock of the artist that has the name steps aside. Where another one that is exported has it,
        this one is numbered: "Wall 2".
        """
        others, free, number = _blocks(block), name, 1
        while (holder := others.get((free, None))) is not None and holder in {*self._kept, *self._made}:
            number += 1
            free = f"{name} {number}"
        if holder is not None and holder != block:
            holder.name = f".fipt_aside_{len(self._renamed)}"
            self._renamed[holder] = free
        self._made.append(block)
        block.name = free
        return block

    def name(self, block: bpy.types.ID) -> str:
        """The name that the artist gave to a datablock, which may have stepped aside."""
        return self._renamed.get(block, block.name)

    def keep_name(self, block: bpy.types.ID) -> None:
        """Export an artist's datablock itself: it keeps its name."""
        self._kept.add(block)

    def mesh(self, item: bpy.types.Object) -> bpy.types.Mesh:
        """A mesh as renders show an object, with the object's name and the materials of its slots."""
        slots = [slot.material for slot in item.material_slots]
        plain = item.type == "MESH" and item.data.shape_keys is None
        if plain and not any(each.show_render for each in item.modifiers):
            mesh = item.data.copy()
        else:
            mesh = self._evaluated(item)
        for index, material in enumerate(slots):
            if index < len(mesh.materials):
                mesh.materials[index] = material
            else:
                mesh.materials.append(material)
        made: bpy.types.Mesh = self.keep(mesh, self.name(item))
        return made

    def _evaluated(self, item: bpy.types.Object) -> bpy.types.Mesh:
        copy = item.copy()
        copy.hide_viewport = False
        self.scene.collection.objects.link(copy)
        for modifier in copy.modifiers:
            for viewport, render in _RENDERED.items():
                if hasattr(modifier, render):
                    setattr(modifier, viewport, getattr(modifier, render))
        layer = self.scene.view_layers[0]
        with bpy.context.temp_override(scene=self.scene, view_layer=layer):
            depsgraph = bpy.context.evaluated_depsgraph_get()
            mesh = bpy.data.meshes.new_from_object(
                copy.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
            )
        bpy.data.objects.remove(copy)
        return mesh


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
