# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Simple shapes of scanned lamps: found in spite of noise and a ragged border, and made as meshes."""

from __future__ import annotations

import json
import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender.blend.lights.lamp_shapes import fit_lamp_shape, shape_mesh
from fipt_blender.blend.marks import BASE, FIXTURE, fixtures_of
from fipt_blender.blend.room.mesh_arrays import corner_vertices, triangle_loops, vertex_positions
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.applied_rooms import RADIANCE
from samples.operator_calls import refused
from samples.refusals import error_of

TURN = np.array(Matrix.Rotation(0.7, 3, (1.0, 2.0, 0.5)))
PLACE = np.array([1.0, -2.0, 1.5])


def grid(mapping, rows: int = 40, columns: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mapping of the unit square, turned and moved into the room."""
    u, v = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    index = np.arange(u.size).reshape(u.shape)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    points = np.stack(mapping(u.ravel(), v.ravel()), axis=1)
    return points @ TURN.T + PLACE, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def ragged(vertices: np.ndarray, triangles: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """As a scan has them: with noise, and without a tenth of the triangles."""
    rng = np.random.default_rng(0)
    kept = rng.random(len(triangles)) < 0.9
    return vertices + rng.normal(0.0, noise, vertices.shape), triangles[kept]


def flat(width: float, height: float):
    return lambda u, v: (width * (u - 0.5), height * (v - 0.5), 0.0 * u)


def ellipse(width: float, height: float):
    return lambda u, v: (0.5 * width * u * np.cos(2 * np.pi * v), 0.5 * height * u * np.sin(2 * np.pi * v), 0.0 * u)


def tube(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    return 0.04 * np.cos(2 * np.pi * u), 0.04 * np.sin(2 * np.pi * u), 1.2 * (v - 0.5)


def ball(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    radius = 0.1 * np.sin(np.pi * u)
    return radius * np.cos(2 * np.pi * v), radius * np.sin(2 * np.pi * v), -0.1 * np.cos(np.pi * u)


AREAS = {
    "RECTANGLE": lambda size: size[0] * size[1],
    "ELLIPSE": lambda size: 0.25 * np.pi * size[0] * size[1],
    "TUBE": lambda size: np.pi * size[0] * (size[2] + 0.5 * size[0]),
    "BALL": lambda size: np.pi * size[0] ** 2,
}


@pytest.mark.parametrize(
    ("mapping", "kind", "size"),
    [
        (flat(0.6, 1.0), "RECTANGLE", [0.6, 1.0, 0.0]),
        (flat(0.8, 0.8), "RECTANGLE", [0.8, 0.8, 0.0]),
        (ellipse(0.6, 0.6), "ELLIPSE", [0.6, 0.6, 0.0]),
        (ellipse(0.6, 0.4), "ELLIPSE", [0.6, 0.4, 0.0]),
        (tube, "TUBE", [0.08, 0.08, 1.2]),
        (ball, "BALL", [0.2, 0.2, 0.2]),
    ],
)
def test_ragged_lamps_have_simple_shapes(mapping, kind: str, size: list[float]) -> None:
    vertices, triangles = ragged(*grid(mapping), 0.002)
    shape = fit_lamp_shape(vertices, triangles)
    assert shape.kind == kind
    assert sorted(shape.size) == pytest.approx(sorted(size), rel=0.06, abs=1e-9)
    assert shape.matrix[:3, 3] == pytest.approx(PLACE, abs=0.02)
    assert shape.matrix[:3, :3] @ shape.matrix[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(shape.matrix[:3, :3]) == pytest.approx(1.0)
    if kind == "RECTANGLE":
        along = np.abs(shape.matrix[:3, :2].T @ TURN[:, :2])
        assert np.sort(along, axis=1)[:, 1] == pytest.approx(1.0, abs=0.005)
    if kind != "BALL":
        assert abs(shape.matrix[:3, 2] @ TURN[:, 2]) == pytest.approx(1.0, abs=0.01)
    # The mesh has the shape's area and faces outwards.
    mesh = shape_mesh("lamp", shape)
    loops, _ = triangle_loops(mesh, mirrored=False)
    corners = vertex_positions(mesh)[corner_vertices(mesh)[loops]].astype(float)
    cross = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(cross, axis=1).sum() == pytest.approx(AREAS[kind](shape.size), rel=0.02)
    if size[2]:
        assert ((cross * corners.mean(axis=1)).sum(axis=1) > 0.0).all()
    else:
        assert (cross[:, 2] > 0.0).all()


def test_no_shape_fits_two_lamps_apart_or_nothing() -> None:
    vertices, triangles = grid(flat(0.8, 0.8))
    both = np.concatenate([vertices, vertices + TURN @ [3.0, 0.0, 0.0]])
    error = error_of(fit_lamp_shape, both, np.concatenate([triangles, triangles + len(vertices)]))
    assert error.code == "shape-unclear"
    assert error_of(fit_lamp_shape, np.zeros((3, 3)), np.array([[0, 1, 2]])).code == "fixture-empty"


ops = bpy.ops.fipt
DIM = [2.0, 1.0, 0.5]
pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def lamps(scene):
    """A room of which two quads shine, the second dimmer."""
    run = RunFolder(scene.fipt.run_folder)
    emitters = json.loads(run.emitters_json.read_text())
    (first,) = emitters["fixtures"]
    beside = [triangle - 2 for triangle in first["triangles"]]
    emitters["fixtures"].append(first | {"name": "Fixture.002", "triangles": beside, "radiance": DIM})
    write_json(run.emitters_json, emitters)
    assert ops.apply_results() == {"FINISHED"}
    assert [row.object[FIXTURE] for row in scene.fipt.lights.lights] == ["Fixture.001", "Fixture.002"]
    scene.render.engine = "CYCLES"
    return scene


def merge(scene):
    for item in fixtures_of(scene):
        item.select_set(True)
    assert ops.merge_lamps() == {"FINISHED"}
    (row,) = scene.fipt.lights.lights
    return row


def emitted(item):
    """Strength of the front of each material slot, by the material."""
    return [slot.material.node_tree.nodes["FIPT Front"].inputs["Strength"].default_value
            for slot in item.material_slots]  # fmt: skip


def test_one_row_one_group_and_every_surface_its_radiance(lamps):
    ops.make_light_groups()
    row = merge(lamps)
    assert emitted(row.object) == pytest.approx([8.0, 2.0]) and row.radiance == pytest.approx(5.0)
    assert row.watts == pytest.approx(math.pi * 10.0, rel=1e-5)
    groups = [group.name for group in bpy.context.view_layer.lightgroups]
    assert sorted(groups) == sorted(["Environment", row.object.lightgroup])
    row.stops = 1.0
    assert emitted(row.object) == pytest.approx([16.0, 4.0])
    row.kelvin = 3000.0
    first, second = emitted(row.object)
    assert first == pytest.approx(4.0 * second)
    ops.fixture_to_area_light()
    energies = sorted(child.data.energy for child in row.object.children)
    assert energies[1] == pytest.approx(4.0 * energies[0]) and sum(energies) == pytest.approx(row.watts)


def test_a_split_lamp_is_as_before(lamps):
    before = {item[FIXTURE]: (list(item[BASE]), bounds(item)) for item in fixtures_of(lamps)}
    row = merge(lamps)
    row.stops = 1.0
    assert ops.split_lamp() == {"FINISHED"}
    found = {item[FIXTURE]: item for item in fixtures_of(lamps)}
    assert found.keys() == before.keys()
    for name, (radiance, box) in before.items():
        assert list(found[name][BASE]) == radiance and np.allclose(bounds(found[name]), box)
        assert emitted(found[name]) == pytest.approx([2.0 * max(radiance)])
    assert "is a single lamp" in refused(ops.split_lamp)


def bounds(item):
    bpy.context.view_layer.update()
    points = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def test_saving_and_applying_again_keep_merged_lamps(lamps, tmp_path):
    row = merge(lamps)
    row.stops = 1.0
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    scene = bpy.context.scene
    assert emitted(scene.fipt.lights.lights[0].object) == pytest.approx([16.0, 4.0])
    assert ops.apply_results() == {"FINISHED"}
    (row,) = scene.fipt.lights.lights
    assert emitted(row.object) == pytest.approx([16.0, 4.0]) and row.stops == 1.0
    # A lamp that the estimate has no more ends the merger.
    run = RunFolder(scene.fipt.run_folder)
    emitters = json.loads(run.emitters_json.read_text())
    write_json(run.emitters_json, emitters | {"fixtures": emitters["fixtures"][:1]})
    assert ops.apply_results() == {"FINISHED"}
    (row,) = scene.fipt.lights.lights
    assert list(row.object[BASE]) == RADIANCE and emitted(row.object) == pytest.approx([8.0])


def test_converted_and_single_lamps_are_not_merged(lamps):
    assert "Select two or more lamps" in refused(ops.merge_lamps)
    ops.fixture_to_area_light()
    for item in fixtures_of(lamps):
        item.select_set(True)
    assert "was converted to Blender lights" in refused(ops.merge_lamps)
    assert len(fixtures_of(lamps)) == 2
