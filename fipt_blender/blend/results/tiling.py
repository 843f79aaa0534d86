"""Texture coordinates in metres for parts whose material was replaced, along the longest wall of the room.

They are a UV layer of the result meshes, which renders use in place of the artist's own; faces of other
materials have the values of that one in it.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..marks import filled_surfaces, room_with_results
from ..room.mesh_arrays import (
    area_normals,
    corner_uvs,
    corner_vertices,
    polygon_sizes,
    polygon_slots,
    polygon_starts,
    world_positions,
)
from ..room.originals import shows_original
from ..room.uv_layer import new_layer
from .materials import slot_estimates

METRES = "FIPT Metres"
_RENDERED = "fipt_render_uv"  # on a result mesh: the layer that renders used before
_UPRIGHT = 0.3  # of a unit normal's Z: faces that are steeper (73 degrees) count as walls
_MOST_LEVEL = 0.7  # above it a face is laid out from above, as a floor


def lay_out(scene: bpy.types.Scene) -> None:
    """Give replaced parts their coordinates, and take them from meshes without one."""
    items = [item for item in room_with_results(scene) if not shows_original(item)]
    items += filled_surfaces(scene)
    replaced = [item for item in items if any(_replaced_slots(item.data))]
    axes = _axes(items) if replaced else np.eye(2)
    for mesh in {item.data for item in items} - {item.data for item in replaced}:
        _take_back(mesh)
    for item in replaced:
        _write(item, axes)


def _replaced_slots(mesh: bpy.types.Mesh) -> list[bool]:
    pairs = zip(mesh.materials, slot_estimates(mesh), strict=True)
    return [estimate is not None and material != estimate for material, estimate in pairs]


def _geometry(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Corners (L, 3) of an object's faces in the world, and the area normals (P, 3) of these."""
    points = world_positions(item)[corner_vertices(item.data)]
    return points, area_normals(points, polygon_starts(item.data))


def _axes(items: list[bpy.types.Object]) -> np.ndarray:
    """(2, 2) rows: level unit vectors along the room's longest wall and across it.

    Walls of a room are parallel to two directions, which their normals, weighted by area, give together.
    """
    found = [_geometry(item) for item in items if len(item.data.polygons)]
    points, normals = (np.concatenate(each) for each in zip(*found, strict=True))
    walls = np.abs(normals[:, 2]) < _UPRIGHT * np.linalg.norm(normals, axis=1)
    turn = (normals[walls, 0] + 1j * normals[walls, 1]) ** 4
    size = np.maximum(np.abs(turn), 1e-30)
    angle = np.angle((turn * size**-0.75).sum() + 1e-30) / 4.0
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    longer = np.ptp(points[:, :2] @ along) >= np.ptp(points[:, :2] @ across)
    return np.stack([along, across] if longer else [across, -along])


def _write(item: bpy.types.Object, axes: np.ndarray) -> None:
    mesh = item.data
    layers = mesh.uv_layers
    if METRES not in layers:
        shown = next((layer.name for layer in layers if layer.active_render), "")
        active = layers.active_index
        new_layer(mesh, METRES)
        layers.active_index = active
        mesh[_RENDERED] = shown
    layer = layers.get(mesh.get(_RENDERED, ""))
    values = np.zeros((len(mesh.loops), 2)) if layer is None else corner_uvs(mesh, layer)
    points, normals = _geometry(item)
    slots = np.array(_replaced_slots(mesh))[np.minimum(polygon_slots(mesh), len(mesh.materials) - 1)]
    sizes = polygon_sizes(mesh)
    level = np.abs(normals[:, 2]) > _MOST_LEVEL * np.linalg.norm(normals, axis=1)
    above = points[:, :2] @ axes.T
    on_wall = np.abs(normals[:, :2] @ axes.T).argmin(axis=1)  # the axis that is more parallel to the face
    side = np.stack(
        [np.take_along_axis(above, np.repeat(on_wall, sizes)[:, None], 1)[:, 0], points[:, 2]], axis=1
    )
    metres = np.where(np.repeat(level, sizes)[:, None], above, side)
    values = np.where(np.repeat(slots, sizes)[:, None], metres, values)
    mesh.attributes[METRES].data.foreach_set("vector", values.astype(np.float32).ravel())
    layers[METRES].active_render = True
    mesh.update()


def _take_back(mesh: bpy.types.Mesh) -> None:
    layers = mesh.uv_layers
    if METRES not in layers:
        return
    shown = layers.get(mesh.get(_RENDERED, ""))
    active = layers.active.name
    layers.remove(layers[METRES])
    if shown is not None:
        layers[str(mesh[_RENDERED])].active_render = True
    if active in layers:
        layers.active = layers[active]
    del mesh[_RENDERED]
