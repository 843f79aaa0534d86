"""Materials that replace those of parts: chosen or dropped, kept with the file, and restored."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender.blend.marks import MATERIAL, PART, room_with_results
from fipt_blender.blend.results.replacing import adopt, replacement
from fipt_blender.blend.results.tiling import METRES
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def choose(scene, name):
    settings = scene.fipt.materials
    settings.active_part = [row.name for row in settings.parts].index(name)
    return settings.part()


def materials(name):
    return [slot.material for slot in bpy.data.objects[name].material_slots]


def test_a_chosen_material_replaces_a_part_until_it_is_restored(applied):
    part = choose(applied, "Cube")
    (estimate,) = materials("cube")
    assert "There is no material" in refused(ops.replace_part_material, material="velvet")
    velvet = bpy.data.materials.new("velvet")
    assert ops.replace_part_material(material="velvet") == {"FINISHED"}
    assert materials("cube") == [velvet] and MATERIAL in materials("panel")[0]
    part.roughness_offset = 0.1  # the estimate can still be changed
    applied.fipt.materials.shown = "ROUGHNESS"  # maps are those of the estimate
    assert materials("cube") == [estimate]
    applied.fipt.materials.shown = "ORIGINAL"
    applied.fipt.materials.shown = "ESTIMATED"
    assert materials("cube") == [velvet]
    assert ops.restore_estimate() == {"FINISHED"}
    assert materials("cube") == [estimate] and part.roughness_offset == pytest.approx(0.1)


def test_saving_applying_again_and_revert(applied, tmp_path):
    choose(applied, "Cube")
    bpy.data.materials.new("velvet")
    ops.replace_part_material(material="velvet")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    scene = bpy.context.scene
    assert [material.name for material in materials("cube")] == ["velvet"]
    assert ops.apply_results() == {"FINISHED"}
    assert [material.name for material in materials("cube")] == ["velvet"]
    assert ops.revert() == {"FINISHED"}
    assert not [material for material in bpy.data.materials if MATERIAL in material]
    assert ops.apply_results() == {"FINISHED"}
    (material,) = materials("cube")
    assert MATERIAL in material and replacement(scene, material[PART]) is None


def test_undo_and_redo_of_a_drop(applied):
    room = room_with_results(applied)
    first, second = (item.data for item in room)
    estimate = first.materials[0]
    second.materials[0] = estimate  # a part that lies on both objects
    bpy.data.materials.new("wood").use_fake_user = True
    bpy.ops.ed.undo_push(message="before")
    first.materials[0] = bpy.data.materials["wood"]
    bpy.ops.ed.undo_push(message="drop")
    bpy.context.view_layer.update()

    def shown():
        bpy.context.view_layer.update()
        return [item.data.materials[0].name for item in room_with_results(bpy.context.scene)]

    name = bpy.data.materials["wood"].name
    assert shown() == [name, name]
    for _ in range(2):
        bpy.ops.ed.undo()
        assert len(set(shown())) == 1 and shown()[0] != name
        bpy.ops.ed.redo()
        assert shown() == [name, name]
    bpy.ops.ed.undo_push(message="another step")
    bpy.ops.ed.undo()
    assert shown() == [name, name]
    bpy.ops.ed.undo()
    assert len(set(shown())) == 1 and shown()[0] != name


def test_a_dropped_material_replaces_the_part_on_all_objects(applied):
    room = room_with_results(applied)
    first, second = (item.data for item in room)
    estimate, other = first.materials[0], second.materials[0]
    second.materials[0] = estimate  # a part that lies on both objects
    wood = bpy.data.materials.new("wood")
    first.materials[0] = wood  # as a drop does
    bpy.context.view_layer.update()
    assert [mesh.materials[0] for mesh in (first, second)] == [wood, wood]
    # The artist's preference may link it to the object.
    slot = room[1].material_slots[0]
    slot.link = "OBJECT"
    slot.material = glass = bpy.data.materials.new("glass")
    adopt(applied, room)
    assert slot.link == "DATA" and first.materials[0] == second.materials[0] == glass
    # An undo brings one slot back, and not what followed it.
    first.materials[0] = estimate
    adopt(applied, room)
    assert second.materials[0] == estimate and replacement(applied, estimate[PART]) is None
    assert MATERIAL in other
    assert adopt(applied, room) == []


def test_a_replaced_part_has_coordinates_in_metres_along_the_longest_wall(applied):
    cube = bpy.data.objects["cube"]
    shown = next((layer.name for layer in cube.data.uv_layers if layer.active_render), "")
    cube.location.y += 2.0  # now the room is longest along Y
    bpy.context.view_layer.update()
    choose(applied, "Cube")
    bpy.data.materials.new("tiles")
    ops.replace_part_material(material="tiles")
    layer = cube.data.uv_layers[METRES]
    assert layer.active_render and METRES not in bpy.data.objects["panel"].data.uv_layers
    uvs = np.array([each.vector for each in layer.uv])
    for polygon in cube.data.polygons:
        corners = np.array([cube.data.vertices[index].co for index in polygon.vertices])
        if np.abs(polygon.normal).max() > 0.99:  # a side of two metres, without its bevel
            assert np.allclose(
                sorted(np.ptp(uvs[list(polygon.loop_indices)], axis=0)), sorted(np.ptp(corners, axis=0))[1:]
            )
    top = next(polygon for polygon in cube.data.polygons if polygon.normal.z > 0.99)
    index = top.loop_indices[0]
    place = cube.matrix_world @ cube.data.vertices[cube.data.loops[index].vertex_index].co
    assert np.allclose(np.abs(uvs[index]), np.abs([place.y, place.x]), atol=1e-4)
    assert ops.apply_results() == {"FINISHED"}
    assert cube.data.uv_layers[METRES].active_render
    assert ops.restore_estimate() == {"FINISHED"}
    assert METRES not in cube.data.uv_layers
    assert next((each.name for each in cube.data.uv_layers if each.active_render), "") == shown
