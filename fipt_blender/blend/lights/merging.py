# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Merged lamps: several fixtures as one object with one row of settings, and their division.

Each keeps its surface, in a material slot of its own, and its radiance, on the material.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ...core.run.parts import free_name
from ..marks import (
    BACK,
    BASE,
    FIXTURE,
    FIXTURE_SOURCES,
    MERGED,
    NAMED,
    UNIT,
    VISIBILITY,
    fixture_lights,
    remove_marks,
)
from ..outliner import FIXTURES, collection, remove_object
from ..room.mesh_arrays import polygon_slots
from .fixture_nodes import surfaces
from .light_drivers import is_animated
from .light_state import SETTINGS
from .power import base_power, slot_areas, world_matrix

# The properties of a fixture's object, kept on the material while the lamp is merged.
_OF_FIXTURE = (FIXTURE, FIXTURE_SOURCES, BASE, BACK)


def merge(items: Iterable[bpy.types.Object]) -> bpy.types.Object:
    """Join fixtures into the most powerful one, which is returned; the others' settings are lost.

    `light_state.refresh` and `list_lights` must follow.

    Raises:
        FiptError: ``merge-few``, ``fixture-converted``, ``fixture-animated`` or ``fixture-empty``.
    """
    items = sorted(items, key=lambda item: -max(base_power(item)) if item.type == "MESH" else 0.0)
    _check(items)
    lamp, sources = items[0], [json.loads(item[FIXTURE_SOURCES]) for item in items]
    members = [name for item in items for name in json.loads(item.get(MERGED, json.dumps([item[FIXTURE]])))]
    points: list[tuple[float, ...]] = []
    faces: list[list[int]] = []
    slots: list[int] = []
    materials: list[bpy.types.Material] = []
    inverse = world_matrix(lamp).inverted()
    for item in items:
        for surface in surfaces(item):
            if BASE not in surface.material:
                _mark(surface.material, item)
        matrix, first = inverse @ world_matrix(item), len(points)
        points += [tuple(matrix @ vertex.co) for vertex in item.data.vertices]
        faces += [[first + index for index in polygon.vertices] for polygon in item.data.polygons]
        slots += [len(materials) + index for index in polygon_slots(item.data).tolist()]
        materials += item.data.materials
    before, name = lamp.data, lamp.data.name
    lamp.data = _new_mesh(name, points, faces, slots, materials)
    if not before.users:
        bpy.data.meshes.remove(before)
        lamp.data.name = name
    for item in items[1:]:
        remove_object(item)
    area = slot_areas(lamp)
    for key in (BASE, BACK):
        radiance = np.array([list(material[key]) for material in materials])
        lamp[key] = (area @ radiance / max(float(area.sum()), 1e-12)).tolist()
    lamp[FIXTURE_SOURCES] = json.dumps(sorted({name for names in sources for name in names}))
    lamp[MERGED] = json.dumps(members)
    return lamp


def split(scene: bpy.types.Scene, lamp: bpy.types.Object) -> list[bpy.types.Object]:
    """Divide a merged lamp into its fixtures again, each with the lamp's settings; the lamp is the first.

    `light_state.refresh` and `list_lights` must follow.

    Raises:
        FiptError: ``fixture-converted`` or ``fixture-animated``.
    """
    _check_plain(lamp)
    merged = lamp.data
    parts: list[bpy.types.Object] = []
    target = collection(scene, FIXTURES)
    for surface in surfaces(lamp):
        material = surface.material
        mesh = _slot_mesh(merged, surface.slot, material)
        if parts:
            name = free_name(material[NAMED], bpy.data.objects.keys())
            part = bpy.data.objects.new(name, mesh)
            part.matrix_world = world_matrix(lamp)
            part[NAMED] = name
            for key in (*SETTINGS, UNIT):
                if key in lamp:
                    part[key] = lamp[key]
            target.objects.link(part)
        else:
            part, lamp.data = lamp, mesh
        for key in _OF_FIXTURE:
            part[key] = material[key]
        remove_marks(material, *_OF_FIXTURE, NAMED)
        parts.append(part)
    if not merged.users:
        bpy.data.meshes.remove(merged)
    remove_marks(lamp, MERGED)
    return parts


def members_of(lamp: bpy.types.Object) -> list[str]:
    """The names in emitters.json of the fixtures that a lamp was merged from; [] for any other."""
    return [str(name) for name in json.loads(lamp.get(MERGED, "[]"))]


def _check(items: Sequence[bpy.types.Object]) -> None:
    if len(items) < 2:
        raise FiptError(
            "merge-few",
            "Fewer than two lamps are selected.",
            "Select the lamps to merge in the viewport or in the Outliner.",
        )
    for item in items:
        _check_plain(item)
        if not surfaces(item) or len(surfaces(item)) != len(item.data.materials):
            raise FiptError(
                "fixture-empty", f"'{item.name}' has lost its material.", "Apply the results again."
            )


def _check_plain(item: bpy.types.Object) -> None:
    if VISIBILITY in item or fixture_lights(item):
        raise FiptError(
            "fixture-converted", f"'{item.name}' was converted to Blender lights.", "Use Convert Back first."
        )
    if is_animated(item):
        raise FiptError(
            "fixture-animated", f"'{item.name}' has keyframes.", "Remove its keyframes first (x)."
        )


def _mark(material: bpy.types.Material, item: bpy.types.Object) -> None:
    """Store on a material which fixture it was."""
    for key in _OF_FIXTURE:
        material[key] = item[key]
    material[NAMED] = str(item.get(NAMED, item.name))


def _slot_mesh(merged: bpy.types.Mesh, slot: int, material: bpy.types.Material) -> bpy.types.Mesh:
    """The faces of one slot of a merged lamp's mesh."""
    own = np.flatnonzero(polygon_slots(merged) == slot).tolist()
    faces = [list(merged.polygons[index].vertices) for index in own]
    used = sorted({vertex for face in faces for vertex in face})
    place = {vertex: number for number, vertex in enumerate(used)}
    points = [tuple(merged.vertices[vertex].co) for vertex in used]
    faces = [[place[vertex] for vertex in face] for face in faces]
    return _new_mesh(material[NAMED], points, faces, [0] * len(faces), [material])


def _new_mesh(
    name: str,
    points: list[tuple[float, ...]],
    faces: list[list[int]],
    slots: list[int],
    materials: list[bpy.types.Material],
) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.array(slots, np.int32))
    mesh.update()
    return mesh
