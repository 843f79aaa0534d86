"""Fixtures on meshes whose polygons are larger than the lamps: each lamp is exactly its triangles."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender.blend.marks import FIXTURE, fixtures_of
from fipt_blender.core.run.run_files import read_room
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.textures import bake
from samples.applied_rooms import ConstantFields, emitter
from samples.at_once import apply_results, export_room, make_atlas
from samples.combinations import pairs


def plate(corners: int, matrix: Matrix) -> bpy.types.Object:
    """A polygon of many corners, a quad and a triangle, all in one mesh."""
    angle = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    points = [(float(np.cos(value)), float(np.sin(value)), 0.0) for value in angle]
    points += [(2.0, 0.0, 0.0), (3.0, 0.0, 0.0), (3.0, 1.0, 0.0), (2.0, 1.0, 0.0), (2.5, 2.0, 0.0)]
    faces = [list(range(corners)), [corners + index for index in range(4)]]
    faces.append([corners + 3, corners + 2, corners + 4])
    mesh = bpy.data.meshes.new("plate")
    mesh.from_pydata(points, [], faces)
    mesh.uv_layers.new(name="own")
    item = bpy.data.objects.new("plate", mesh)
    item.matrix_world = matrix
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    return item


def area(item: bpy.types.Object) -> float:
    return sum(polygon.area for polygon in item.data.polygons)


@pytest.mark.parametrize(("mirrored", "seed", "corners"), pairs((False, True), range(2), (4, 9, 24)))
def test_no_lamp_of_an_estimate_is_dropped(tmp_path, corners, seed, mirrored):
    """Lamps of random triangles, whatever their share of a polygon; applied twice, and after an estimate
    without lamps.
    """
    rng = np.random.default_rng(seed)
    item = plate(corners, Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0)) if mirrored else Matrix())
    run = RunFolder(tmp_path)
    run.create(make_settings())
    export_room([item], run)
    room = read_room(run)
    sides = room.vertices[room.triangles]
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    lamp = rng.integers(-1, 3, len(areas))
    lamp[rng.integers(len(areas))] = -1  # something stays
    chosen = {f"Fixture.{number:03d}": np.flatnonzero(lamp == number) for number in range(3)}
    wanted = {name: rows for name, rows in chosen.items() if len(rows)}

    def estimate(lamps) -> None:
        fixtures = [emitter(name, rows, sides[rows].mean(axis=(0, 1))) for name, rows in lamps.items()]
        write_json(run.emitters_json, {"fixtures": fixtures, "environment": None})

    estimate(wanted)
    make_atlas([item], run, make_settings(changes={"texel_density": 16.0}))
    bake.bake(run, ConstantFields())
    for _ in range(2):
        assert not apply_results(run, [item])
        found = {each[FIXTURE]: area(each) for each in fixtures_of(bpy.context.scene)}
        assert found == pytest.approx({name: areas[rows].sum() for name, rows in wanted.items()}, rel=1e-5)
        assert area(item) == pytest.approx(areas[lamp < 0].sum(), rel=1e-5)
    estimate({})
    assert not apply_results(run, [item])
    assert not fixtures_of(bpy.context.scene)
    assert area(item) == pytest.approx(areas.sum(), rel=1e-5) and len(item.data.polygons) == 3
