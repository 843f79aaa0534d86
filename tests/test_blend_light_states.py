# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""States of all lights, and keyframes of their power."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest

from fipt_blender.blend.lights import light_states
from samples.applied_rooms import front
from samples.refusals import error_of

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered", "applied")


def test_a_state_is_recalled_exactly(scene):
    row, settings = scene.fipt.lights.lights[0], scene.fipt.lights
    row.stops, row.kelvin, settings.environment_factor = 1.5, 3000.0, 0.25
    settings.environment_rotation = 0.5
    saved, shone = light_states.present(scene), front(row.object)
    row.on, row.tint, settings.environment_on, settings.environment_rotation = False, "ESTIMATED", False, 0.0
    assert not front(row.object).any()
    light_states.recall(scene, saved)
    assert np.allclose(front(row.object), shone) and row.kelvin == 3000.0 and row.tint == "TEMPERATURE"
    assert settings.environment_on and settings.environment_factor == 0.25
    assert settings.environment_rotation == pytest.approx(0.5)


def test_damaged_states_are_refused_and_other_settings_ignored(scene):
    for text in ("", "[]", '{"lights": {}}', '{"lights": {"a": {"rgb": [1, 2]}}, "world": null}'):
        assert error_of(light_states.recall, scene, text).code == "state-damaged"
    state = json.loads(light_states.present(scene))
    state["lights"]["Fixture.001"]["settings"]["fipt_fixture"] = "Sun"
    state["lights"]["Fixture.001"]["rgb"] = [1.0, 1.0, 1.0]  # of an earlier release
    light_states.recall(scene, json.dumps(state))
    assert scene.fipt.lights.lights[0].object["fipt_fixture"] == "Fixture.001"


def test_keyframes_of_the_power_of_a_blender_light_survive_another_apply(scene):
    assert ops.fixture_to_area_light(fixture="Fixture.001") == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    power = light.data.energy
    light.data.keyframe_insert("energy", frame=1)
    light.data.energy = 4.0 * power
    light.data.keyframe_insert("energy", frame=11)
    scene.frame_set(1)
    assert ops.apply_results() == {"FINISHED"}
    (light,) = scene.fipt.lights.lights[0].object.children
    for frame, factor in ((11, 4.0), (1, 1.0)):
        scene.frame_set(frame)
        assert light.data.energy == pytest.approx(factor * power, rel=1e-4)
