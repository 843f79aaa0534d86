# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Merged lamps: one row, one light group, their radiances; undone by Split Lamp, kept by Apply Results."""

from __future__ import annotations

import json
import math

import bpy
import numpy as np
import pytest

from fipt_blender.blend.marks import BASE, FIXTURE, fixtures_of
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.applied_rooms import RADIANCE
from samples.operator_calls import refused

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
