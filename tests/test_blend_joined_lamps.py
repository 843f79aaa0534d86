"""Fixtures that the artist joins in Blender are one lamp, of which every surface keeps its radiance."""

from __future__ import annotations

import json
import math

import bpy
import pytest

from fipt_blender.blend.marks import FIXTURE, fixtures_of
from fipt_blender.core.run.runfolder import RunFolder, write_json

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


def emitted(item):
    """Strength of the front of each material slot, by the material."""
    return [slot.material.node_tree.nodes["FIPT Front"].inputs["Strength"].default_value
            for slot in item.material_slots]  # fmt: skip


def join(scene):
    for item in scene.objects:
        item.select_set(item in fixtures_of(scene))
    bpy.context.view_layer.objects.active = scene.fipt.lights.lights[0].object
    assert bpy.ops.object.join() == {"FINISHED"} and ops.list_lights() == {"FINISHED"}
    (row,) = scene.fipt.lights.lights
    return row


def test_one_row_and_every_surface_its_radiance(lamps):
    row = join(lamps)
    assert emitted(row.object) == pytest.approx([8.0, 2.0])
    assert row.watts == pytest.approx(math.pi * 10.0, rel=1e-5)
    row.stops = 1.0
    assert emitted(row.object) == pytest.approx([16.0, 4.0])
    row.kelvin = 3000.0
    first, second = emitted(row.object)
    assert first == pytest.approx(4.0 * second)
    ops.fixture_to_area_light()
    energies = sorted(child.data.energy for child in row.object.children)
    assert energies[1] == pytest.approx(4.0 * energies[0]) and sum(energies) == pytest.approx(row.watts)


def test_another_apply_keeps_joined_lamps(lamps):
    row = join(lamps)
    row.stops = 1.0
    assert ops.apply_results() == {"FINISHED"}
    (row,) = lamps.fipt.lights.lights
    assert emitted(row.object) == pytest.approx([16.0, 4.0]) and row.stops == 1.0
