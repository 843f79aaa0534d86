# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Apply Results on a room whose objects were renamed, deleted or changed after the estimation."""

from __future__ import annotations

import bpy
import pytest

from fipt_blender.blend import marks
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running
from samples.applied_rooms import fingerprint
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def warned() -> str:
    """What the last Apply Results warned of."""
    return " ".join(message["text"] for message in running.last("materials").warnings)


@pytest.mark.parametrize("density", [16.0, 32.0])
def test_renamed_objects_keep_their_results(applied, density):
    names = ("cube", "box"), ("panel", "wall")
    for old, new in names:
        bpy.data.objects[old].name = new
    applied.fipt.materials.texel_density = density
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert all(marks.has_results(bpy.data.objects[new]) for _, new in names)
    # The fixture of the renamed panel was replaced: a second one would double the light.
    assert [item.name for item in applied.objects if marks.is_fixture(item)] == ["Panel"]
    assert len(bpy.data.objects["wall"].data.polygons) == 2
    assert len(bpy.data.materials["Panel FIPT"].node_tree.nodes)


@pytest.mark.parametrize("density", [16.0, 32.0])
@pytest.mark.parametrize("mode", ["uv", "color_attribute"])
def test_deleted_objects_are_left_out_with_a_warning(scene, density, mode):
    scene.fipt.materials.atlas_mode = mode
    ops.apply_results()
    bpy.data.objects.remove(bpy.data.objects["panel"])
    scene.fipt.materials.texel_density = density
    assert ops.apply_results() == {"FINISHED"}
    assert "'panel'" in warned() and "'cube'" not in warned()
    assert marks.has_results(bpy.data.objects["cube"])
    # Its lamp is an object of its own, which the artist has kept.
    assert [item.name for item in scene.objects if marks.is_fixture(item)] == ["Panel"]
    assert scene.fipt.materials.object_count == 1


def test_an_object_with_other_faces_shows_its_own_materials(applied):
    cube = bpy.data.objects["cube"]
    ops.show_map(shown="ORIGINAL")
    cube.modifiers["Bevel"].segments = 3
    assert ops.apply_results() == {"FINISHED"} and "'cube'" in warned()
    assert not marks.has_results(cube) and marks.has_results(bpy.data.objects["panel"])
    assert [slot.material.name for slot in cube.material_slots] == ["red", "own", "blue"]
    cube.modifiers["Bevel"].segments = 1
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert marks.has_results(cube)


def test_objects_are_found_by_their_ids_not_by_the_names_of_others(applied):
    cube, panel = bpy.data.objects["cube"], bpy.data.objects["panel"]
    cube.name, panel.name = "aside", "cube"
    cube.name = "panel"
    copy = panel.copy()  # with its id
    bpy.data.collections["FIPT Room"].objects.link(copy)
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert len(cube.data.polygons) > 6 and len(panel.data.polygons) == 2


def test_runs_without_ids_match_by_name(scene):
    run = RunFolder(scene.fipt.run_folder)
    names = read_json(run.room_json)
    assert names.pop("object_ids") == ["panel", "cube"]
    write_json(run.room_json, names)
    for item in scene.objects:
        marks.remove_marks(item, marks.OBJECT_ID)
    assert ops.apply_results() == {"FINISHED"} and not warned()
    bpy.data.objects["panel"].name = "wall"  # applying gave it an id
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert len(bpy.data.objects["wall"].data.polygons) == 2


def test_a_room_without_any_estimated_object_is_refused(applied):
    room = bpy.data.collections["FIPT Room"]
    for item in list(room.objects):
        room.objects.unlink(item)
        applied.collection.objects.link(item)
    bpy.ops.mesh.primitive_cube_add()
    room.objects.link(bpy.context.object)
    before = fingerprint(applied)
    assert "None of the estimated objects" in refused(ops.apply_results)
    assert fingerprint(applied) == before
