# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated emitters as objects "Ceiling panel" ... that the artist can select, move, switch and dim.

A fixture's polygons move from the room's result meshes into an object of its own;
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

from ...core.report.fixture_names import fixture_names
from ...core.run.parts import RoomParts, free_name
from ..marks import BACK, BASE, FIXTURE, FIXTURE_SOURCES, NAMED, PROBABILITY, object_id
from ..outliner import FIXTURES, collection
from ..room.arrays import Room
from ..room.mesh_arrays import is_mirrored
from ..room.originals import number_polygons, original_polygons
from .fixture_nodes import emission_material


@dataclass(frozen=True)
class NewFixture:
    """A fixture that is not in a scene yet.

    Attributes:
        entry: its entry of emitters.json.
        name: what it is called in Blender (`fixture_names`).
        mesh: its polygons, around its centre.
        center: its centre in the world.
        sources: ids of the objects that it was split off.
    """

    entry: Mapping[str, Any]
    name: str
    mesh: bpy.types.Mesh
    center: Vector
    sources: list[str]


@dataclass(frozen=True)
class _Piece:
    """Polygons of one object of the room that belong to a fixture."""

    item: bpy.types.Object
    mesh: bpy.types.Mesh  # the object's result mesh
    polygons: np.ndarray  # indices into the mesh


def split_off(
    room: Room,
    entries: Sequence[Mapping[str, Any]],
    targets: Mapping[int, tuple[bpy.types.Object, bpy.types.Mesh]],
    parts: RoomParts | None = None,
) -> list[NewFixture]:
    """Move the emitters' polygons out of the result meshes.

    Args:
        room: the run's room.
        entries: the fixtures of emitters.json.
        targets: objects with their new result meshes, by their indices in the room.
        parts: the room's parts, for the fixtures' names.
    """
    polygon_fixtures = {
        index: fixture for index, fixture in _polygon_fixtures(room, entries).items() if index in targets
    }
    pieces: list[list[_Piece]] = [[] for _ in entries]
    for index, polygon_fixture in polygon_fixtures.items():
        item, mesh = targets[index]
        fixture = polygon_fixture[original_polygons(mesh)]
        for number in np.unique(fixture[fixture >= 0]):
            pieces[number].append(_Piece(item, mesh, np.flatnonzero(fixture == number)))
    names = fixture_names(room, entries, parts)
    made = [
        _make(entry, name, parts) for entry, name, parts in zip(entries, names, pieces, strict=True) if parts
    ]
    for index, polygon_fixture in polygon_fixtures.items():
        mesh = targets[index][1]
        _remove_polygons(mesh, np.flatnonzero(polygon_fixture[original_polygons(mesh)] >= 0))
    return made


def place(scene: bpy.types.Scene, fixtures: Sequence[NewFixture]) -> list[bpy.types.Object]:
    """Put new fixtures into a scene's collection FIPT Fixtures, each with its material."""
    target = collection(scene, FIXTURES)
    items = []
    for fixture in fixtures:
        entry, name = fixture.entry, free_name(fixture.name, bpy.data.objects.keys())
        fixture.mesh.name = name
        light = entry["radiance"], entry["back_radiance"]
        fixture.mesh.materials.append(emission_material(name, *light))
        item = bpy.data.objects.new(name, fixture.mesh)
        item.matrix_world = Matrix.Translation(fixture.center)
        item[FIXTURE], item[NAMED] = entry["name"], name
        item[FIXTURE_SOURCES] = json.dumps(fixture.sources)
        item[BASE] = [float(value) for value in entry["radiance"]]
        item[PROBABILITY] = float(entry.get("probability", 1.0))
        item[BACK] = [float(value) for value in entry["back_radiance"]]
        target.objects.link(item)
        items.append(item)
    return items


def _polygon_fixtures(room: Room, entries: Sequence[Mapping[str, Any]]) -> dict[int, np.ndarray]:
    """By index of each object with emitters: the fixture of each of its polygons, -1 for none.

    A polygon belongs to a fixture that holds at least half of its triangles.
    """
    triangle_fixture = np.full(len(room.triangles), -1)
    for index, fixture in enumerate(entries):
        triangle_fixture[np.array(fixture["triangles"], np.int64)] = index
    polygon_fixtures = {}
    for index in np.unique(room.triangle_object[triangle_fixture >= 0]):
        of_object = room.triangle_object == index
        polygon, fixture = room.triangle_polygon[of_object], triangle_fixture[of_object]
        count = int(polygon.max()) + 1
        total = np.bincount(polygon, minlength=count)
        polygon_fixture = np.full(count, -1)
        for number in np.unique(fixture[fixture >= 0]):
            most = np.bincount(polygon[fixture == number], minlength=count) * 2 >= np.maximum(total, 1)
            polygon_fixture[most] = number
        polygon_fixtures[int(index)] = polygon_fixture
    return polygon_fixtures


def _make(entry: Mapping[str, Any], name: str, pieces: list[_Piece]) -> NewFixture:
    """A fixture with copies of its polygons, wound as in room.npz."""
    points: list[Vector] = []
    faces: list[list[int]] = []
    for piece in pieces:
        index_of: dict[int, int] = {}
        mirrored = is_mirrored(piece.item)
        for polygon in piece.polygons:
            vertices = list(piece.mesh.polygons[int(polygon)].vertices)
            for vertex in vertices:
                if vertex not in index_of:
                    index_of[vertex] = len(points)
                    points.append(piece.item.matrix_world @ piece.mesh.vertices[vertex].co)
            face = [index_of[vertex] for vertex in vertices]
            faces.append(face[::-1] if mirrored else face)
    center = sum(points, Vector()) / len(points)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(point - center) for point in points], [], faces)
    return NewFixture(entry, name, mesh, center, [object_id(piece.item) for piece in pieces])


def _remove_polygons(mesh: bpy.types.Mesh, polygons: np.ndarray) -> None:
    """Remove polygons with the edges and vertices that only they have, which Blender would draw as lines."""
    number_polygons(mesh)
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bm.faces.ensure_lookup_table()
    bmesh.ops.delete(bm, geom=[bm.faces[int(index)] for index in polygons], context="FACES")
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()
