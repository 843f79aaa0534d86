"""Estimated emitters as objects "Ceiling panel" ... that the artist can select, move, switch and dim.

A fixture's polygons move from the room's result meshes into an object of its own;
`originals.restore_original` undoes that. A polygon of which the fixture has some triangles is divided into
its triangles before (`divide`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.report.fixture_names import fixture_names
from ...core.run.names import free_name
from ...core.run.parts import RoomParts
from ...core.run.result_contents import EmitterFixture
from ...core.run.run_files import RoomMesh
from ..marks import (
    BACK,
    BASE,
    CENTROID,
    FIXTURE,
    FIXTURE_SOURCES,
    NAMED,
    PLACED,
    PROBABILITY,
    UNIT,
    object_id,
)
from ..outliner import FIXTURES, collection
from ..room.mesh_arrays import is_mirrored, remove_polygons, triangle_loops
from ..room.mesh_digest import sign
from .calibration import scene_unit
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

    entry: EmitterFixture
    name: str
    mesh: bpy.types.Mesh
    center: Vector
    sources: list[str]


@dataclass(frozen=True)
class Source:
    """An object of the room with its new result mesh.

    Attributes:
        item: the object.
        mesh: its new result mesh.
        triangle: (P,) triangle of the room that each polygon shows, -1 for none.
    """

    item: bpy.types.Object
    mesh: bpy.types.Mesh
    triangle: np.ndarray


@dataclass(frozen=True)
class _Piece:
    """Polygons of one object of the room that belong to a fixture."""

    item: bpy.types.Object
    mesh: bpy.types.Mesh  # the object's result mesh
    polygons: np.ndarray  # indices into the mesh


def triangle_fixtures(entries: Sequence[EmitterFixture], count: int) -> np.ndarray:
    """(T,) index of the fixture of each of the room's triangles, -1 for none.

    Args:
        entries: the fixtures of emitters.json.
        count: T.
    """
    fixture = np.full(count, -1)
    for index, entry in enumerate(entries):
        fixture[np.array(entry.triangles, np.int64)] = index
    return fixture


def split_off(
    room: RoomMesh,
    entries: Sequence[EmitterFixture],
    sources: Sequence[Source],
    parts: RoomParts | None = None,
) -> list[NewFixture]:
    """Move the emitters' polygons out of the result meshes.

    Args:
        room: the run's room.
        entries: the fixtures of emitters.json.
        sources: the objects; each mesh once.
        parts: the room's parts, for the fixtures' names.
    """
    # The last one stands for -1.
    of_triangle = np.append(triangle_fixtures(entries, len(room.triangles)), -1)
    pieces: list[list[_Piece]] = [[] for _ in entries]
    for source in sources:
        fixture = of_triangle[source.triangle]
        for number in np.unique(fixture[fixture >= 0]):
            polygons = np.flatnonzero(fixture == number)
            pieces[number].append(_Piece(source.item, source.mesh, polygons))
    names = fixture_names(room, entries, parts)
    made = [
        _make(entry, name, parts) for entry, name, parts in zip(entries, names, pieces, strict=True) if parts
    ]
    for source in sources:
        lit = of_triangle[source.triangle] >= 0
        if lit.any():  # edges without faces would be drawn as lines
            remove_polygons(source.mesh, lit)
    return made


def place(scene: bpy.types.Scene, fixtures: Sequence[NewFixture]) -> list[bpy.types.Object]:
    """Put new fixtures into a scene's collection FIPT Fixtures, each with its material."""
    target = collection(scene, FIXTURES)
    items = []
    for fixture in fixtures:
        entry, name = fixture.entry, free_name(fixture.name, bpy.data.objects.keys())
        fixture.mesh.name = name
        material = emission_material(name, entry.radiance, entry.back_radiance)
        material[BASE], material[BACK] = entry.radiance, entry.back_radiance  # for lamps that are joined
        fixture.mesh.materials.append(material)
        item = bpy.data.objects.new(name, fixture.mesh)
        item.matrix_world = Matrix.Translation(fixture.center)
        item[FIXTURE], item[NAMED], item[PLACED] = entry.name, name, fixture.center
        item[CENTROID] = entry.centroid or fixture.center
        item[FIXTURE_SOURCES] = json.dumps(fixture.sources)
        item[BASE] = entry.radiance
        item[PROBABILITY] = entry.probability
        item[BACK] = entry.back_radiance
        item[UNIT] = scene_unit(scene)
        target.objects.link(item)
        sign(fixture.mesh)
        items.append(item)
    return items


def _make(entry: EmitterFixture, name: str, pieces: list[_Piece]) -> NewFixture:
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


def divide(mesh: bpy.types.Mesh, label: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Replace polygons whose triangles have different labels by their triangles.

    Args:
        mesh: changed.
        label: (T,) int of the mesh's triangles (`triangle_loops`).
        first: (P,) first triangle of each polygon.

    Returns:
        (P,) triangle before the division that is the first of each polygon after it.
    """
    loops, polygon = triangle_loops(mesh, False)
    mixed = np.unique(polygon[label != label[first[polygon]]])
    if not len(mixed):
        return first
    bm = bmesh.new()
    bm.from_mesh(mesh)
    layer = bm.faces.layers.int.new("fipt_triangle")
    bm.faces.ensure_lookup_table()
    faces = list(bm.faces)
    for face, triangle in zip(faces, first.tolist(), strict=True):
        face[layer] = triangle
    start = np.array([face.loops[0].index for face in faces])
    for number in mixed.tolist():
        corners = list(faces[number].loops)
        begin, end = np.searchsorted(polygon, [number, number + 1])
        for triangle in range(begin, end):
            chosen = [corners[loop - start[number]] for loop in loops[triangle].tolist()]
            try:
                new = bm.faces.new([corner.vert for corner in chosen], faces[number])
            except ValueError:  # the mesh has this face already
                continue
            new[layer] = triangle
            for corner, old in zip(new.loops, chosen, strict=True):
                corner.copy_from(old)
    bmesh.ops.delete(bm, geom=[faces[number] for number in mixed.tolist()], context="FACES_ONLY")
    bm.to_mesh(mesh)
    bm.free()
    divided = np.empty(len(mesh.polygons), np.int32)
    mesh.attributes["fipt_triangle"].data.foreach_get("value", divided)
    mesh.attributes.remove(mesh.attributes["fipt_triangle"])
    mesh.update()
    return divided
