# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""States of all lights, keyframes and IES profiles, as scripts drive them."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from samples.applied_rooms import RADIANCE, front
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered", "applied")


def test_states_are_saved_recalled_blended_and_removed(scene):
    settings = scene.fipt.lights
    row = settings.lights[0]
    assert "Save a light state first" in refused(ops.recall_light_state)
    assert ops.save_light_state() == {"FINISHED"}
    row.stops = 2.0
    assert ops.save_light_state(kind="PRESENT", name="Bright") == {"FINISHED"}
    assert ops.save_light_state(kind="LAMP") == {"FINISHED"}
    assert ops.save_light_state(kind="PHOTOGRAPHED") == {"FINISHED"}
    assert ops.save_light_state(kind="EVENING") == {"FINISHED"}
    names = [state.name for state in settings.states]
    assert names == ["Lights", "Bright", "Panel", "As Photographed", "Evening"] and settings.active_state == 4
    assert ops.recall_light_state(state="Lights") == {"FINISHED"} and row.stops == 0.0
    assert ops.save_light_state(name="Evening") == {"FINISHED"} and len(settings.states) == 5
    settings.blend_from, settings.blend_to = "Lights", "Bright"
    settings.blend = 0.5
    assert np.allclose(front(row.object), 2.5 * np.array(RADIANCE), rtol=1e-4)
    assert "no light state 'Day'" in refused(ops.recall_light_state, state="Day")
    settings.states["Bright"].data = "{}"
    assert "damaged" in refused(ops.recall_light_state, state="Bright")
    settings.blend = 0.25  # nothing to blend, and no error
    assert ops.remove_light_state(state="Bright") == {"FINISHED"} and not settings.can_blend()
    for _ in range(4):
        ops.remove_light_state()
    assert not len(settings.states) and not ops.remove_light_state.poll()


def test_an_ies_profile_needs_a_blender_light(scene, tmp_path):
    path = tmp_path / "lamp.ies"
    path.write_text("IESNA\nTILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 10 10", encoding="utf-8")
    assert "Convert to Blender Light" in refused(ops.set_ies_profile, filepath=str(path))
    ops.fixture_to_area_light()
    (light,) = scene.fipt.lights.lights[0].object.children
    assert ops.set_ies_profile(filepath=str(path)) == {"FINISHED"} and light.data.type == "POINT"
    assert ops.apply_results() == {"FINISHED"}  # the profile stays
    (light,) = scene.fipt.lights.lights[0].object.children
    assert light.data.type == "POINT" and any(n.type == "TEX_IES" for n in light.data.node_tree.nodes)
    assert "no IES profile" in refused(ops.set_ies_profile, filepath=__file__)
    assert ops.remove_ies_profile() == {"FINISHED"} and light.data.type == "AREA"
    assert ops.area_light_to_fixture() == {"FINISHED"}
    ops.revert()
