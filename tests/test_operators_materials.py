"""Apply Results, maps and Revert, run as scripts do: what they show, keep and refuse."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend import marks
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.properties.materials import SHOWN
from samples.applied_rooms import MEDIAN, ConstantFields, fingerprint, picture
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def test_apply_puts_maps_lights_and_exposure_onto_the_scene(applied):
    settings = applied.fipt.materials
    assert (settings.object_count, settings.image_count, settings.applied_mode) == (2, 1, "uv")
    assert [row.name for row in applied.fipt.lights.lights] == ["Panel"]
    assert applied.view_settings.exposure == pytest.approx(np.log2(0.18 / MEDIAN))
    assert applied.world.name == "FIPT World"
    sun = bpy.data.objects["sun"]
    assert sun.hide_render and sun.hide_viewport
    mesh = bpy.data.objects["cube"].data
    assert mesh.uv_layers.active.name == "FIPT" and mesh.name == "Cube FIPT"


def test_applying_again_replaces_and_bakes_only_what_changed(applied, bakes):
    before = fingerprint(applied)
    assert ops.apply_results() == {"FINISHED"}
    assert fingerprint(applied) == before and bakes == ["apply-textures"]
    applied.fipt.materials.texel_density = 32.0
    assert ops.apply_results() == {"FINISHED"}
    assert bakes == ["apply-textures"] * 2
    assert fingerprint(applied).keys() == before.keys()


@pytest.mark.parametrize("mode", ["uv", "color_attribute"])
@pytest.mark.parametrize("shown", ["ESTIMATED", "ORIGINAL", "ROUGHNESS"])
def test_revert_restores_the_file(scene, mode, shown):
    before = fingerprint(scene)
    scene.fipt.materials.atlas_mode = mode
    assert ops.apply_results() == {"FINISHED"}
    ops.fixture_to_area_light(fixture="Fixture.001")
    ops.make_light_groups()
    ops.show_map(shown=shown)
    assert ops.revert() == {"FINISHED"}
    assert fingerprint(scene) == before
    assert not ops.revert.poll() and not ops.show_map.poll()


def test_revert_keeps_new_lights_by_default(applied):
    ops.add_light(location=(0, 0, 2))
    ops.revert()
    assert [row.name for row in applied.fipt.lights.lights] == ["FIPT Light"]
    ops.apply_results()
    ops.revert(new_lights=True)
    assert "FIPT Light" not in bpy.data.objects and not len(applied.fipt.lights.lights)


def test_maps_show_their_values(applied):
    above, spot = Vector((0, 5, 4)), Vector((0, 5, 0))
    applied.view_settings.view_transform = "AgX"
    kept = applied.view_settings.exposure
    expected = {
        # As Blender's colour fields show it: with sRGB's transfer function.
        "BASE_COLOR": [1.055 * value ** (1 / 2.4) - 0.055 for value in ConstantFields.base_color],
        "ROUGHNESS": [ConstantFields.roughness] * 3,
        "METALLIC": [ConstantFields.metallic] * 3,
        "EMISSION": [0.0] * 3,
        "CONFIDENCE": [1.0] * 3,
    }
    for shown, values in expected.items():
        assert ops.show_map(shown=shown) == {"FINISHED"}
        assert np.allclose(picture(applied, above, spot), values, atol=0.01), shown
        outside = picture(applied, Vector((20, 0, 5)), Vector((20, 0, 9)))
        if shown != "EMISSION":
            assert (outside < 1e-3).all()
    ops.show_map(shown="EMISSION")
    lamp = bpy.data.objects["Panel"].matrix_world.translation
    srgb = [1.0, 1.055 * 0.5 ** (1 / 2.4) - 0.055, 1.055 * 0.25 ** (1 / 2.4) - 0.055]
    assert np.allclose(picture(applied, lamp + Vector((0, 0, 2)), lamp), srgb, atol=0.01)
    ops.show_map(shown="ESTIMATED")
    assert applied.view_settings.view_transform == "AgX" and applied.view_settings.exposure == kept


@pytest.mark.parametrize("mode", ["uv", "color_attribute"])
def test_showing_maps_changes_nothing(scene, mode):
    scene.fipt.materials.atlas_mode = mode
    ops.apply_results()
    material = bpy.data.objects["cube"].data.materials[0]

    def links():
        return sorted(
            (link.from_node.name, link.from_socket.name, link.to_node.name, link.to_socket.name)
            for link in material.node_tree.links
        )

    before, links_before = fingerprint(scene), links()
    for shown, *_ in (*SHOWN, *reversed(SHOWN)):
        ops.show_map(shown=shown)
    assert fingerprint(scene) == before and links() == links_before
    assert scene.fipt.materials.shown == "ESTIMATED"


def test_original_is_the_artists_own(applied):
    cube = bpy.data.objects["cube"]
    ours = cube.data
    ops.show_map(shown="ORIGINAL")
    assert cube.data.name == "Cube" and cube.modifiers[0].show_viewport
    assert [slot.material.name for slot in cube.material_slots] == ["red", "own", "blue"]
    assert applied.world.name == "sky" and bpy.data.collections["Lamps"].hide_render
    cube.material_slots[1].material = bpy.data.materials["green"]  # the artist's change
    ops.show_map(shown="ESTIMATED")
    assert cube.data == ours and not cube.modifiers[0].show_viewport
    ops.revert()
    assert [slot.material.name for slot in cube.material_slots] == ["red", "green", "blue"]


def test_an_artists_node_before_the_output_is_restored(applied):
    tree = bpy.data.objects["cube"].data.materials[0].node_tree
    output = tree.nodes["FIPT Output"]
    before = output.inputs["Surface"].links[0].from_socket
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.name = "mine"
    tree.links.new(before, mix.inputs[1])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    for shown in ("METALLIC", "CONFIDENCE", "ESTIMATED"):
        ops.show_map(shown=shown)
    assert tree.nodes["FIPT Output"].inputs["Surface"].links[0].from_node.name == "mine"


@pytest.mark.parametrize("mode", ["uv", "color_attribute"])
def test_solid_viewports_draw_maps_and_are_restored(scene, mode):
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    space = next(area.spaces.active for area in areas if area.type == "VIEW_3D")
    space.shading.type = "SOLID"
    space.shading.color_type = "RANDOM"
    scene.fipt.materials.atlas_mode = mode
    ops.apply_results()
    drawn = "TEXTURE" if mode == "uv" else "VERTEX"
    steps = ("ROUGHNESS", drawn), ("EMISSION", "MATERIAL"), ("ORIGINAL", "RANDOM"), ("ESTIMATED", drawn)
    for shown, color in steps:
        ops.show_map(shown=shown)
        assert space.shading.color_type == color, shown
    if mode == "color_attribute":
        ops.show_map(shown="METALLIC")
        assert bpy.data.objects["cube"].data.color_attributes.active_color.name == "FIPT Metallic"
    ops.revert()
    assert space.shading.color_type == "RANDOM"


def test_what_apply_needs(scene, tmp_path):
    scene.fipt.run_folder = ""
    assert not ops.apply_results.poll()
    scene.fipt.run_folder = str(tmp_path / "nowhere")
    assert "no run" in refused(ops.apply_results)
    scene.fipt.run_folder = str(tmp_path / "run")
    (tmp_path / "run" / "results" / "fields.npz").unlink()
    assert "no results yet" in refused(ops.apply_results)
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert not ops.apply_results.poll()
    bpy.ops.object.mode_set(mode="OBJECT")


def test_a_missing_texture_changes_nothing(applied):
    before = fingerprint(applied)
    (RunFolder(applied.fipt.run_folder).textures / "Room.001.roughness.exr").unlink()
    assert "roughness" in refused(ops.apply_results)
    assert fingerprint(applied) == before


def test_stopping_halfway_changes_nothing(applied):
    from fipt_blender.blend.results.applying import apply_results

    before = fingerprint(applied)
    run = RunFolder(applied.fipt.run_folder)
    for count in (1, 2):
        slices = apply_results(run, applied.fipt.capture.room_objects(applied), applied)
        for _ in range(count):
            next(slices)
        slices.close()
        assert fingerprint(applied) == before


def test_results_and_state_survive_saving(applied, tmp_path):
    ops.show_map(shown="ORIGINAL")
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    assert scene.fipt.materials.shown == "ORIGINAL"
    ops.show_map(shown="ESTIMATED")
    assert bpy.data.objects["cube"].data.name == "Cube FIPT"
    assert len(marks.room_with_results(scene)) == 2
    ops.revert()
    assert not any(marks.has_results(item) for item in bpy.data.objects)


def test_each_is_one_step_of_undo(scene):
    def now():
        return fingerprint(bpy.context.scene)

    bpy.ops.ed.undo_push(message="before")
    states = [now()]
    steps = (
        lambda: ops.apply_results("EXEC_DEFAULT", True),
        lambda: ops.show_map("EXEC_DEFAULT", True, shown="ROUGHNESS"),
        lambda: ops.show_map("EXEC_DEFAULT", True, shown="ORIGINAL"),
        lambda: ops.switch_lights("EXEC_DEFAULT", True, on=False),
        lambda: ops.revert("EXEC_DEFAULT", True),
    )
    for step in steps:
        assert step() == {"FINISHED"}
        states.append(now())
    for state in reversed(states[:-1]):
        bpy.ops.ed.undo()
        assert now() == state
    for state in states[1:]:
        bpy.ops.ed.redo()
        assert now() == state
    bpy.ops.ed.undo()
    # Everything works after undo: the list, the room and its maps.
    scene = bpy.context.scene
    assert [row.object.name for row in scene.fipt.lights.lights] == ["Panel"]
    scene.fipt.materials.shown = "ESTIMATED"
    assert len(marks.room_with_results(scene)) == 2
