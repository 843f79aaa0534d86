# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated emitters as objects "Fixture.001" ... that an artist can select, move, switch and dim.

A fixture's polygons move from the room's meshes (our copies of them) into an object of its own;
`originals.restore_original` undoes that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from ..properties.lights import BACK, BASE, FIXTURE, ON
from . import light_state
from .fixture_nodes import emission_material
from .originals import FIXTURE_SOURCES, original_polygons
from .outliner import FIXTURES, collection
from .room_export import Room, is_mirrored


@dataclass
class NewFixture:
    """A fixture whose mesh is made, not yet in any scene."""

    entry: Mapping[str, Any]  # of emitters.json
    mesh: bpy.types.Mesh
    centre: Vector
    sources: list[str]  # names of the objects it was split off


def split_off(
    room: Room,
    entries: Sequence[Mapping[str, Any]],
    targets: Sequence[tuple[bpy.types.Object, bpy.types.Mesh]],
) -> list[NewFixture]:
    """Take the emitters' polygons out of meshes of ours.

    Args:
        room: of the run.
        entries: the fixtures of emitters.json.
        targets: for each object of the room, in its order, the mesh that it is to have.
    """
    owner = _polygon_fixture(room, entries)
    pieces: list[list[tuple[bpy.types.Object, bpy.types.Mesh, np.ndarray]]] = [[] for _ in entries]
    for index, polygon_fixture in owner.items():
        item, mesh = targets[index]
        fixture = polygon_fixture[original_polygons(mesh)]
        for each in np.unique(fixture[fixture >= 0]):
            pieces[each].append((item, mesh, np.flatnonzero(fixture == each)))
    made = [_make(entry, parts) for entry, parts in zip(entries, pieces, strict=True) if parts]
    for index, polygon_fixture in owner.items():
        mesh = targets[index][1]
        _remove_polygons(mesh, np.flatnonzero(polygon_fixture[original_polygons(mesh)] >= 0))
    return made


def place(scene: bpy.types.Scene, made: Sequence[NewFixture]) -> list[bpy.types.Object]:
    """Put new fixtures into a scene's collection FIPT Fixtures, each with its material."""
    target = collection(scene, FIXTURES)
    items = []
    for fixture in made:
        entry, name = fixture.entry, fixture.entry["name"]
        fixture.mesh.name = name
        base_color = entry.get("base_color", [0.0, 0.0, 0.0])
        light = entry["radiance"], entry["back_radiance"]
        fixture.mesh.materials.append(emission_material(name, *light, base_color))
        item = bpy.data.objects.new(name, fixture.mesh)
        item.matrix_world = Matrix.Translation(fixture.centre)
        item[FIXTURE] = name
        item[FIXTURE_SOURCES] = json.dumps(fixture.sources)
        item[BASE] = [float(value) for value in entry["radiance"]]
        item[BACK] = [float(value) for value in entry["back_radiance"]]
        target.objects.link(item)
        items.append(item)
    return items


def _polygon_fixture(room: Room, entries: Sequence[Mapping[str, Any]]) -> dict[int, np.ndarray]:
    """For each object with emitters the fixture of each polygon, -1 for none.

    A polygon belongs to the fixture that holds at least half of its triangles.
    """
    triangle_fixture = np.full(len(room.triangles), -1)
    for index, fixture in enumerate(entries):
        triangle_fixture[np.array(fixture["triangles"], np.int64)] = index
    owner = {}
    for index in np.unique(room.triangle_object[triangle_fixture >= 0]):
        mine = room.triangle_object == index
        polygon, fixture = room.triangle_polygon[mine], triangle_fixture[mine]
        count = int(polygon.max()) + 1
        total = np.bincount(polygon, minlength=count)
        polygon_fixture = np.full(count, -1)
        for each in np.unique(fixture[fixture >= 0]):
            share = np.bincount(polygon[fixture == each], minlength=count) * 2 >= np.maximum(total, 1)
            polygon_fixture[share] = each
        owner[int(index)] = polygon_fixture
    return owner


def _make(
    entry: Mapping[str, Any], parts: list[tuple[bpy.types.Object, bpy.types.Mesh, np.ndarray]]
) -> NewFixture:
    """A mesh around the fixture's centre with copies of the polygons, wound as in room.npz."""
    points: list[Vector] = []
    faces: list[list[int]] = []
    for source, mesh, polygons in parts:
        index_of: dict[int, int] = {}
        mirrored = is_mirrored(source)
        for polygon in polygons:
            vertices = list(mesh.polygons[int(polygon)].vertices)
            for vertex in vertices:
                if vertex not in index_of:
                    index_of[vertex] = len(points)
                    points.append(source.matrix_world @ mesh.vertices[vertex].co)
            face = [index_of[vertex] for vertex in vertices]
            faces.append(face[::-1] if mirrored else face)
    centre = sum(points, Vector()) / len(points)
    made = bpy.data.meshes.new(entry["name"])
    made.from_pydata([tuple(point - centre) for point in points], [], faces)
    return NewFixture(entry, made, centre, [source.name for source, _, _ in parts])


def _remove_polygons(mesh: bpy.types.Mesh, polygons: np.ndarray) -> None:
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bm.faces.ensure_lookup_table()
    bmesh.ops.delete(bm, geom=[bm.faces[int(index)] for index in polygons], context="FACES_ONLY")
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()


def fixtures(scene: bpy.types.Scene | None = None) -> list[bpy.types.Object]:
    """All fixture objects of a scene (the context's by default), sorted by name."""
    return [item for item in light_state.lights_of(scene or bpy.context.scene) if FIXTURE in item]


def find_fixture(name: str, scene: bpy.types.Scene | None = None) -> bpy.types.Object:
    """A fixture by its name or its object's.

    Raises:
        FiptError: ``fixture-missing``.
    """
    for item in fixtures(scene):
        if name in (item[FIXTURE], item.name):
            return item
    raise FiptError("fixture-missing", f"There is no fixture '{name}'.", "Name one of the room's fixtures.")


def set_fixture_enabled(name: str, on: bool) -> None:
    """Switch one fixture of the context's scene: off, its surface is black and reflects nothing.

    Raises:
        FiptError: ``fixture-missing``.
    """
    light_state.change(bpy.context.scene, find_fixture(name), {ON: on})
