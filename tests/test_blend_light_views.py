# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights in viewports: outlines, rows that follow the selection, aiming, and the set-up for EEVEE."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend.lights import eevee, new_lights, outline
from fipt_blender.blend.marks import VISIBILITY, light_probe
from fipt_blender.blend.render_engine import switch_engine
from samples.applied_rooms import make_applied_scene
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    return make_applied_scene(tmp_path / "run", monkeypatch)


def test_the_outline_of_an_open_mesh_is_its_border():
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, size=2.0)
    points = np.array(outline.outline(bpy.context.object))
    assert len(points) == 2 * 12 and (np.abs(points[:, :2]).max(axis=1) == 1.0).all()
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    assert len(outline.outline(bpy.context.object)) == 2 * 12


@pytest.mark.parametrize(("shape", "reach"), [("RECTANGLE", (0.5, 1.0, 0.0)), ("ELLIPSE", (0.5, 1.0, 0.0))])
def test_the_outline_of_an_area_light_is_its_shape(shape, reach):
    bpy.ops.object.light_add(type="AREA")
    light = bpy.context.object.data
    light.shape, light.size, light.size_y = shape, 1.0, 2.0
    assert np.allclose(np.abs(outline.outline(bpy.context.object)).max(axis=0), reach)


def test_selecting_a_light_activates_its_row(scene):
    ops.add_light(location=(0, 0, 3))
    fixture = scene.fipt.lights.lights[0].object
    assert scene.fipt.lights.active == 1
    bpy.context.view_layer.objects.active = fixture
    outline.follow_selection()
    assert scene.fipt.lights.active == 0
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    outline.follow_selection()
    assert scene.fipt.lights.active == 0
    ops.fixture_to_area_light(fixture=fixture.name)
    scene.fipt.lights.active = 1
    bpy.context.view_layer.objects.active = fixture.children[0]
    outline.follow_selection()
    assert scene.fipt.lights.active == 0


def test_a_light_is_aimed_and_its_beam_ends_on_the_room():
    bpy.ops.mesh.primitive_plane_add(size=10.0)
    ops.add_light(location=(1.0, 0.0, 3.0))
    light, scene = bpy.context.object, bpy.context.scene
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((1, 0, 0))).length < 1e-5
    assert ops.aim_light(target=(-2.0, 1.0, 0.0)) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert (light.location - Vector((1, 0, 3))).length < 1e-6
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((-2, 1, 0))).length < 1e-4
    ops.aim_light(target=(1.0, 0.0, 9.0))
    bpy.context.view_layer.update()
    assert (new_lights.beam_end(scene, graph, light, 2.0) - Vector((1, 0, 5))).length < 1e-4
    assert "at this point" in refused(ops.aim_light, target=(1.0, 0.0, 3.0))
    bpy.context.view_layer.objects.active = bpy.data.objects["Plane"]
    assert not ops.aim_light.poll()


def test_the_room_is_set_up_for_eevee_and_reverted(scene):
    assert scene.render.engine == "CYCLES" and not scene.fipt.lights.needs_cycles()
    scene.fipt.lights.median_radiance = 0.0018
    settings = {name: getattr(scene.eevee, name) for name in ("use_raytracing", "light_threshold")}
    assert not settings["use_raytracing"]
    assert ops.prepare_eevee() == {"FINISHED"}
    assert scene.eevee.use_raytracing
    assert scene.eevee.light_threshold == pytest.approx(1e-4)  # of a hundredth of a usual exposure
    assert "EEVEE" in scene.render.engine and not scene.fipt.lights.needs_cycles()
    (fixture,) = [row.object for row in scene.fipt.lights.lights]
    assert VISIBILITY in fixture and len(fixture.children) == 1
    volume = light_probe(scene)
    bpy.context.view_layer.update()
    corners = np.array([volume.matrix_world @ Vector(sign) for sign in ((-1, -1, -1), (1, 1, 1))])
    # EEVEE fades the volume into the world before its border: the walls are one sample within it.
    data = volume.data
    spacing = (corners[1] - corners[0]) / (data.resolution_x, data.resolution_y, data.resolution_z)
    assert np.allclose(corners[0] + spacing, (-1, 0, -1), atol=1e-5)
    assert np.allclose(corners[1] - spacing, (5, 6, 1), atol=1e-5)
    assert np.allclose(corners.mean(axis=0), (2, 3, 0), atol=1e-5)
    assert tuple(eevee.resolution(np.array([0.1, 4.0, 100.0]))) == (4, 10, 32)
    assert ops.prepare_eevee() == {"FINISHED"} and len(bpy.data.lightprobes) == 1
    assert "only in a window" in refused(ops.bake_probe)
    ops.revert()
    assert not bpy.data.lightprobes and not ops.bake_probe.poll() and not ops.prepare_eevee.poll()
    assert settings == {name: getattr(scene.eevee, name) for name in settings}


@pytest.mark.parametrize("engines", [["CYCLES"], ["BLENDER_WORKBENCH"], eevee.ENGINES])
def test_revert_restores_the_artists_engine_however_often_it_was_switched(scene, engines):
    ops.revert()
    keys = set(scene.keys())
    assert switch_engine(scene, engines)  # without results nothing is kept
    before = scene.render.engine
    ops.apply_results()
    for switch in (ops.prepare_eevee, ops.use_cycles, ops.prepare_eevee, ops.use_cycles):
        assert switch() == {"FINISHED"}
    ops.revert()
    assert scene.render.engine == before and set(scene.keys()) == keys
    ops.apply_results()
    ops.prepare_eevee()
    scene.render.engine = "BLENDER_WORKBENCH"  # the artist's choice, from which we switch again
    ops.use_cycles()
    ops.revert()
    assert scene.render.engine == "BLENDER_WORKBENCH"


def test_a_room_is_needed_for_eevee(scene):
    bpy.data.batch_remove(list(bpy.data.collections["Parts"].objects))
    assert "no room" in refused(ops.prepare_eevee)
    assert scene.render.engine == "CYCLES"
