"""What an artist does with a room that has results, and what must still be there afterwards."""

from __future__ import annotations

from collections import Counter

import bpy
import numpy as np

from fipt_blender.blend import marks

Faces = Counter[tuple[float, ...]]


def edited(name: str, chosen: list[int]) -> None:
    """Enter Edit Mode on an object with these faces selected."""
    item = bpy.data.objects[name]
    only(item)
    for index, polygon in enumerate(item.data.polygons):
        polygon.select = index in chosen
    for edge in item.data.edges:
        edge.select = False
    for vertex in item.data.vertices:
        vertex.select = False
    for index in chosen:
        for vertex_index in item.data.polygons[index].vertices:
            item.data.vertices[vertex_index].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)


def only(*items: bpy.types.Object) -> None:
    """Select these objects alone; the first is active."""
    layer = bpy.context.view_layer
    layer.update()
    for each in layer.objects:
        each.select_set(each in items)
    layer.objects.active = items[0]


def delete_faces(name: str) -> None:
    edited(name, [0])
    bpy.ops.mesh.delete(type="FACE")
    bpy.ops.object.mode_set(mode="OBJECT")


def separate(name: str) -> None:
    """Make an object of the last face."""
    edited(name, [len(bpy.data.objects[name].data.polygons) - 1])
    bpy.ops.mesh.separate(type="SELECTED")
    bpy.ops.object.mode_set(mode="OBJECT")


def extrude(name: str) -> None:
    edited(name, [0])
    bpy.ops.mesh.extrude_region_move(TRANSFORM_OT_translate={"value": (0.0, 0.0, 0.7)})
    bpy.ops.object.mode_set(mode="OBJECT")


def subdivide(name: str) -> None:
    edited(name, list(range(len(bpy.data.objects[name].data.polygons))))
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")


def join(name: str, other: str) -> None:
    only(bpy.data.objects[name], bpy.data.objects[other])
    bpy.ops.object.join()


def add_modifier(name: str, kind: str) -> None:
    modifier = bpy.data.objects[name].modifiers.new(kind, kind)
    if kind == "SOLIDIFY":
        modifier.thickness = 0.3
    if kind == "BEVEL":
        modifier.width = 0.02


def apply_modifier(name: str, kind: str) -> None:
    item = bpy.data.objects[name]
    add_modifier(name, kind)
    if item.data.users > 1:
        item.data = item.data.copy()
    only(item)
    bpy.ops.object.modifier_apply(modifier=item.modifiers[-1].name)


def faces(item: bpy.types.Object) -> Faces:
    """The faces of a mesh object by the places of their corners, bit for bit."""
    return faces_of(item.data)


def faces_of(mesh: bpy.types.Mesh) -> Faces:
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    positions = positions.reshape(-1, 3)
    return Counter(tuple(positions[list(polygon.vertices)].ravel().tolist()) for polygon in mesh.polygons)


def shown(item: bpy.types.Object) -> Counter[str]:
    """How many faces of an object as it is rendered have the material of each part; "" for others."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    slots = [slot.material for slot in item.material_slots] or [None]
    materials = [slots[min(polygon.material_index, len(slots) - 1)] for polygon in mesh.polygons]
    evaluated.to_mesh_clear()
    return Counter("" if each is None else str(each.get(marks.PART_NAME, "")) for each in materials)
