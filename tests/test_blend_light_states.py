# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""States of all lights, blends of two, and keyframes that work in renders without the add-on."""

from __future__ import annotations

import json
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

import fipt_blender
from fipt_blender.blend.lights import light_drivers, light_states
from fipt_blender.blend.pictures import state_pictures
from fipt_blender.blend.pictures.cycles import RenderOptions, render_exr
from fipt_blender.blend.pictures.image_files import read_pixels, save_look
from fipt_blender.core.run.runfolder import RunFolder
from samples.applied_rooms import RADIANCE, front
from samples.refusals import error_of
from samples.spots import spot

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered", "applied")


def test_a_state_is_recalled_exactly(scene):
    row, settings = scene.fipt.lights.lights[0], scene.fipt.lights
    row.stops, row.kelvin, settings.environment_factor = 1.5, 3000.0, 0.25
    settings.environment_rotation = 0.5
    saved, shone = light_states.read(light_states.write(light_states.present(scene))), front(row.object)
    light_states.recall(scene, light_states.as_photographed(scene))
    assert np.allclose(front(row.object), RADIANCE) and settings.environment_factor == 1.0
    assert settings.environment_rotation == 0.0
    light_states.recall(scene, saved)
    assert np.allclose(front(row.object), shone) and row.kelvin == 3000.0 and row.tint == "TEMPERATURE"
    assert settings.environment_factor == 0.25 and settings.environment_rotation == pytest.approx(0.5)


def test_made_states(scene):
    ops.add_light(location=(0, 0, 3), power=50.0)
    fixture, added = (row.object for row in scene.fipt.lights.lights)
    light_states.recall(scene, light_states.only(scene, added))
    assert not front(fixture).any() and added.data.energy == pytest.approx(50.0)
    assert not scene.fipt.lights.environment_on
    light_states.recall(scene, light_states.evening(scene))
    assert np.allclose(front(fixture), RADIANCE) and not scene.fipt.lights.environment_on
    light_states.recall(scene, light_states.as_photographed(scene))
    assert np.allclose(front(fixture), RADIANCE) and added.data.energy == 0.0
    assert scene.fipt.lights.environment_on


@pytest.mark.parametrize("factor", [0.0, 0.25, 1.0])
def test_a_blend_lies_between_in_radiance(scene, factor):
    row = scene.fipt.lights.lights[0]
    row.color = (0.2, 0.4, 1.0)
    first, blue = light_states.present(scene), front(row.object)
    row.stops, row.kelvin, scene.fipt.lights.environment_factor = 2.0, 2700.0, 3.0
    second, warm = light_states.present(scene), front(row.object)
    light_states.blend(scene, first, second, factor)
    assert np.allclose(front(row.object), (1.0 - factor) * blue + factor * warm, rtol=1e-4)
    assert scene.fipt.lights.environment_factor == pytest.approx(1.0 + 2.0 * factor)
    dark = light_states.only(scene, scene.fipt.lights.lights[0].object)
    dark["lights"]["Fixture.001"]["rgb"] = [0.0] * 3
    light_states.blend(scene, dark, dark, 0.5)
    assert not front(row.object).any() and not row.on


def test_damaged_states_are_refused_and_other_settings_ignored(scene):
    for text in ("", "[]", '{"lights": {}}', '{"lights": {"a": {"rgb": [1, 2]}}, "world": null}'):
        assert error_of(light_states.read, text).code == "state-damaged"
    state = light_states.present(scene)
    state["lights"]["Fixture.001"]["settings"]["fipt_fixture"] = "Sun"
    assert "fipt_fixture" not in light_states.read(json.dumps(state))["lights"]["Fixture.001"]["settings"]


def keyframed(scene: bpy.types.Scene) -> bpy.types.Object:
    """The fixture: as estimated on frame 1, blue and two stops brighter on 11, off on 21."""
    row = scene.fipt.lights.lights[0]
    light_drivers.keyframe(row.object, 1)
    row.stops, row.color = 2.0, (0.2, 0.4, 1.0)
    light_drivers.keyframe(row.object, 11)
    row.on = False
    light_drivers.keyframe(row.object, 21)
    return row.object


def test_keyframes_of_power_color_and_switch(scene):
    item = keyframed(scene)
    row = scene.fipt.lights.lights[0]
    scene.frame_set(1)
    assert np.allclose(front(item), RADIANCE, rtol=1e-5) and row.stops == 0.0
    scene.frame_set(11)
    blue = front(item)
    assert np.allclose(blue / blue.max(), (0.2, 0.4, 1.0)) and row.stops == 2.0
    scene.frame_set(6)
    assert row.stops == pytest.approx(1.0) and front(item).max() > max(RADIANCE)
    scene.frame_set(21)
    assert not front(item).any() and not row.on
    scene.frame_set(11)
    row.stops = 3.0  # until the frame changes
    assert np.allclose(front(item), 2.0 * blue)
    row.solo = True
    assert front(item).any()
    ops.add_light(location=(0, 0, 3))
    row.solo, scene.fipt.lights.lights[1].solo = False, True
    assert not front(item).any()
    scene.fipt.lights.lights[1].solo = False
    light_drivers.clear(item)
    scene.frame_set(1)
    assert np.allclose(front(item), 2.0 * blue) and not item.data.materials[0].node_tree.animation_data.drivers
    ops.reset_light(light="Fixture.001")
    assert np.allclose(front(item), RADIANCE)


def test_keyframes_drive_blender_lights_and_survive_another_apply(scene):
    item = keyframed(scene)
    assert ops.fixture_to_area_light(fixture="Fixture.001") == {"FINISHED"}
    for _ in range(2):
        (light,) = item.children
        scene.frame_set(1)
        base = math.pi * max(RADIANCE)
        assert light.data.energy * max(light.data.color) == pytest.approx(base, rel=1e-4)
        scene.frame_set(11)
        assert light.data.energy > 4.0 * base and tuple(light.data.color) == pytest.approx((0.2, 0.4, 1.0))
        scene.frame_set(21)
        assert light.data.energy == 0.0
        scene.frame_set(11)
        assert ops.apply_results() == {"FINISHED"}
        item = scene.fipt.lights.lights[0].object


def test_two_frames_are_rendered_with_their_own_light(scene):
    item = keyframed(scene)
    scene.view_settings.view_transform = "Standard"
    scene.frame_set(1)
    seen = {}
    fipt_blender.unregister()  # the file renders without the add-on, too
    try:
        for frame in (1, 11, 21):
            scene.frame_set(frame)
            seen[frame] = spot(item.location + Vector((0.0, 0.0, 2.0)), item.location, 4, 3).mean(axis=(0, 1))
    finally:
        fipt_blender.register()
    assert np.allclose(seen[1], RADIANCE, rtol=1e-3)
    assert np.allclose(seen[11] / seen[11].max(), (0.2, 0.4, 1.0), rtol=1e-3) and seen[11].max() > 20.0
    assert not seen[21].any()


def test_a_thumbnail_is_the_sum_of_its_lights(scene, tmp_path, monkeypatch):
    """What is saved later is drawn without another render, and agrees with a render of that state."""
    monkeypatch.setattr(state_pictures, "LONGER_SIDE", 32)
    run = RunFolder(scene.fipt.run_folder)
    row = scene.fipt.lights.lights[0]
    ops.add_light(location=(2, 3, 3), power=50.0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (2.0, 3.0, 6.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 90, 10
    before = light_states.present(scene)
    state_pictures.render_lights(scene, run, "CPU")
    assert light_states.present(scene) == before
    row.stops, row.color, scene.fipt.lights.environment_factor = -1.0, (1.0, 0.3, 0.1), 0.5
    assert ops.save_light_state(name="Dim") == {"FINISHED"}
    picture = Path(scene.fipt.lights.states["Dim"].picture)
    shown = read_pixels(picture)
    assert shown.shape == (18, 32, 3) and shown.max() > 0.05
    render_exr(scene, tmp_path / "dim.exr", RenderOptions(64))
    save_look(tmp_path / "dim.exr", tmp_path / "dim.png", scene)
    expected = read_pixels(tmp_path / "dim.png")
    assert np.allclose(shown.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), atol=0.02)
