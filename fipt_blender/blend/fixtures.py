# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated emitters as objects "Fixture.001" ... that an artist can select, move, switch and dim.

A fixture's polygons move from the room's meshes (our copies of them) into an object of its own;
`originals.restore_original` undoes that.
"""

from __future__ import annotations

import json

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from .originals import FIXTURE_SOURCES, original_polygons
from .outliner import FIXTURES, collection
from .room_export import Room, is_mirrored

FIXTURE = "fipt_fixture"
STRENGTH = "fipt_strength"
BACK_STRENGTH = "fipt_back_strength"


def add_fixtures(run: RunFolder, room: Room, by_name: dict[str, bpy.types.Object]) -> list[str]:
    """Split the run's emitters off the room's objects.

    Args:
        run: results/emitters.json is read.
        room: of the run.
        by_name: the room's objects, holding our meshes.

    Returns:
        Names of the fixture objects, in the order of emitters.json.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    fixtures = read_json(run.emitters_json)["fixtures"]
    target = collection(bpy.context.scene, FIXTURES)
    owner = _polygon_fixture(room, fixtures)
    pieces: list[list[tuple[bpy.types.Object, np.ndarray]]] = [[] for _ in fixtures]
    for name, polygon_fixture in owner.items():
        original = original_polygons(by_name[name].data)
        for index in np.unique(polygon_fixture[polygon_fixture >= 0]):
            polygons = np.flatnonzero(polygon_fixture[original] == index)
            if len(polygons):
                pieces[index].append((by_name[name], polygons))
    names = []
    for fixture, parts in zip(fixtures, pieces, strict=True):
        if parts:
            item = _fixture_object(fixture, parts)
            target.objects.link(item)
            names.append(item.name)
    for name, polygon_fixture in owner.items():
        mesh = by_name[name].data
        _remove_polygons(mesh, np.flatnonzero(polygon_fixture[original_polygons(mesh)] >= 0))
    return names


def _polygon_fixture(room: Room, fixtures: list[dict]) -> dict[str, np.ndarray]:
    """For each object with emitters the fixture of each polygon, -1 for none.

    A polygon belongs to the fixture that holds at least half of its triangles.
    """
    triangle_fixture = np.full(len(room.triangles), -1)
    for index, fixture in enumerate(fixtures):
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
        owner[room.objects[index]] = polygon_fixture
    return owner


def _fixture_object(fixture: dict, parts: list[tuple[bpy.types.Object, np.ndarray]]) -> bpy.types.Object:
    """A new object at the fixture's centre that holds copies of the polygons, wound as in room.npz."""
    points: list[Vector] = []
    faces: list[list[int]] = []
    for source, polygons in parts:
        index_of: dict[int, int] = {}
        mirrored = is_mirrored(source)
        for polygon in polygons:
            vertices = list(source.data.polygons[int(polygon)].vertices)
            for vertex in vertices:
                if vertex not in index_of:
                    index_of[vertex] = len(points)
                    points.append(source.matrix_world @ source.data.vertices[vertex].co)
            face = [index_of[vertex] for vertex in vertices]
            faces.append(face[::-1] if mirrored else face)
    centre = sum(points, Vector()) / len(points)
    name = fixture["name"]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(point - centre) for point in points], [], faces)
    mesh.materials.append(emission_material(name, fixture["radiance"], fixture["back_radiance"]))
    item = bpy.data.objects.new(name, mesh)
    item.matrix_world = Matrix.Translation(centre)
    item[FIXTURE] = name
    item[FIXTURE_SOURCES] = json.dumps([source.name for source, _ in parts])
    return item


def _remove_polygons(mesh: bpy.types.Mesh, polygons: np.ndarray) -> None:
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bm.faces.ensure_lookup_table()
    bmesh.ops.delete(bm, geom=[bm.faces[int(index)] for index in polygons], context="FACES_ONLY")
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()


def emission_material(name: str, radiance: list[float], back_radiance: list[float]) -> bpy.types.Material:
    """A surface that emits and reflects nothing; each side has its own radiance.

    Args:
        name: of the material; one of that name is made anew.
        radiance, back_radiance: rgb leaving the front (where normals point) and the back, W/(m² sr).
    """
    material = bpy.data.materials.get(name) or bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (400, 0)
    mix = nodes.new("ShaderNodeMixShader")
    mix.location = (200, 0)
    geometry = nodes.new("ShaderNodeNewGeometry")
    geometry.location = (-40, 260)
    links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    links.new(mix.outputs["Shader"], output.inputs["Surface"])
    for slot, label, values, key in (
        (1, "Front", radiance, STRENGTH),
        (2, "Back", back_radiance, BACK_STRENGTH),
    ):
        node = nodes.new("ShaderNodeEmission")
        node.name, node.label = f"FIPT {label}", f"{label}: strength is radiance"
        node.location = (-40, 60 - 140 * (slot - 1))
        strength = float(max(values))
        color = [float(value) / strength for value in values] if strength > 0.0 else [1.0, 1.0, 1.0]
        node.inputs["Color"].default_value = (*color, 1.0)
        node.inputs["Strength"].default_value = strength
        material[key] = strength
        links.new(node.outputs["Emission"], mix.inputs[slot])
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        material.cycles.emission_sampling = "FRONT_BACK" if max(back_radiance) > 0.0 else "FRONT"
    return material


def fixtures() -> list[bpy.types.Object]:
    """All fixture objects of the file, sorted by name."""
    return sorted((item for item in bpy.data.objects if FIXTURE in item), key=lambda item: item.name)


def set_fixture_enabled(name: str, on: bool) -> None:
    """Switch one fixture: off, its surface is black and reflects nothing.

    Raises:
        FiptError: ``fixture-missing``.
    """
    item = next((each for each in fixtures() if each[FIXTURE] == name or each.name == name), None)
    if item is None:
        raise FiptError(
            "fixture-missing", f"There is no fixture '{name}'.", "Name one of the room's fixtures."
        )
    material = item.data.materials[0]
    for label, key in (("FIPT Front", STRENGTH), ("FIPT Back", BACK_STRENGTH)):
        strength = material.node_tree.nodes[label].inputs["Strength"]
        if on:
            strength.default_value = material[key]
        elif strength.default_value > 0.0:
            material[key] = strength.default_value  # the artist may have dimmed it
            strength.default_value = 0.0
