# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A room that is linked from another file or overridden: nothing of it is changed, and the buttons say so."""

from __future__ import annotations

import bpy
import pytest

from fipt_blender.blend import marks
from fipt_blender.blend.lights import light_state
from samples.applied_rooms import front
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(params=[False, True])
def shot(applied, request, tmp_path):
    """A shot file with the room's collections, linked or overridden."""
    run, room = applied.fipt.run_folder, str(tmp_path / "room.blend")
    bpy.ops.wm.save_as_mainfile(filepath=room)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(room, link=True) as (source, target):
        target.collections = source.collections
    scene = bpy.context.scene
    inner = {child for each in target.collections for child in each.children_recursive}
    rooms = [each for each in target.collections if each not in inner]
    for each in rooms:
        scene.collection.children.link(each)
    if request.param:
        layer = bpy.context.view_layer
        for each in rooms:
            each.override_hierarchy_create(scene, layer, do_fully_editable=True)
            scene.collection.children.unlink(each)
    scene.fipt.run_folder, scene.fipt.materials.object_count = run, 2
    light_state.list_lights(scene)
    return scene


def test_a_linked_room_is_said_and_not_changed(shot):
    (row,) = [row for row in shot.fipt.lights.lights if marks.is_fixture(row.object)]
    lamp = row.object
    assert lamp.library is not None or lamp.override_library is not None
    before = front(lamp).tolist(), dict(lamp.items()).keys()
    for operator in (ops.apply_results, ops.revert, ops.show_map, ops.switch_lights, ops.export_room):
        assert not operator.poll()
        assert "linked" in refused(operator)
    row.on = False
    row.stops = 2.0
    assert (front(lamp).tolist(), dict(lamp.items()).keys()) == before
