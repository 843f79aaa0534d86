# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Apply Results, maps and Revert, run as scripts do: what they show, keep and refuse."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.pictures.image_files import read_pixels
from fipt_blender.blend.room.atlas import atlas_slices
from fipt_blender.blend.slices import run_through
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import running
from fipt_blender.properties.materials import SHOWN
from samples.applied_rooms import MEDIAN, ConstantFields, fingerprint, make_scene, use_fake_engine

ops = bpy.ops.fipt


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def bakes(monkeypatch):
    return use_fake_engine(monkeypatch)


@pytest.fixture
def scene(tmp_path, bakes):
    return make_scene(tmp_path / "run")


@pytest.fixture
def applied(scene):
    assert ops.apply_results("EXEC_DEFAULT") == {"FINISHED"}
    return scene


def refused(operator, **arguments) -> str:
    with pytest.raises(RuntimeError) as error:
        operator(**arguments)
    return str(error.value)


def picture(scene, position, target, size=9, ortho=0.2):
    """A spot in a small Cycles render with the view transform, 0 to 1, (3,)."""
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale = "ORTHO", ortho
    turn = (target - position).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    camera.matrix_world = Matrix.Translation(position) @ turn
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.image_settings.file_format, scene.render.dither_intensity = "PNG", 0.0
    path = bpy.app.tempdir + "shown.png"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True, scene=scene.name)
    pixels = read_pixels(path)
    bpy.data.objects.remove(camera)
    return pixels.mean(axis=(0, 1))


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
    assert applied.world.name == "sky" and bpy.data.collections["FIPT Fixtures"].hide_render
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


def test_solid_shading_draws_the_map(applied):
    nodes = bpy.data.objects["cube"].data.materials[0].node_tree.nodes
    for shown, label in (
        ("ROUGHNESS", "Roughness"),
        ("ESTIMATED", "Base Color"),
        ("CONFIDENCE", "Confidence"),
    ):
        ops.show_map(shown=shown)
        assert nodes.active.name == f"FIPT {label}"


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


def test_light_settings_survive_another_apply(applied):
    lamp = applied.fipt.lights.lights[0]
    lamp.stops, lamp.kelvin = -1.0, 2700.0
    ops.fixture_to_area_light(fixture="Fixture.001")
    ops.apply_results()
    lamp = applied.fipt.lights.lights[0]
    assert lamp.stops == -1.0 and lamp.kelvin == 2700.0
    assert [item.name for item in lamp.object.children] == ["Panel Light"]


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


def textures(scene) -> list[bpy.types.Image]:
    """The images of the applied materials and of the environment."""
    nodes = list(scene.world.node_tree.nodes)
    for material in bpy.data.materials:
        if marks.MATERIAL in material:
            nodes += material.node_tree.nodes
    images = [node.image for node in nodes if getattr(node, "image", None) is not None]
    return list(dict.fromkeys(images))  # parts share them


def test_textures_of_a_saved_file_lie_beside_it(scene, tmp_path):
    blend = tmp_path / "shot" / "kitchen.blend"
    blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert ops.apply_results() == {"FINISHED"}
    names = sorted(image.filepath for image in textures(scene))
    maps = ("base_color", "confidence", "metallic", "roughness")
    assert names == [
        *(f"//kitchen_textures/Room.001.{name}.exr" for name in maps),
        "//kitchen_textures/environment.exr",
    ]
    sizes = {image.size[:] for image in textures(scene)}
    scene.fipt.materials.texel_density = 64.0
    assert ops.apply_results() == {"FINISHED"}
    assert sizes != {image.size[:] for image in textures(scene)}  # the copies are the new ones
    bpy.ops.wm.save_mainfile()
    # On another machine, without the run folder:
    (tmp_path / "run").rename(tmp_path / "gone")
    (tmp_path / "shot").rename(tmp_path / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "kitchen.blend"))
    assert all(image.size[0] for image in textures(bpy.context.scene))
    image = bpy.data.materials["Panel FIPT"].node_tree.nodes["FIPT Roughness"].image
    assert max(list(image.pixels)[::4]) == pytest.approx(ConstantFields.roughness, abs=1e-3)


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_a_moved_file_finds_its_textures(scene, tmp_path, suffix):
    blend = tmp_path / "shot" / "kitchen.blend"
    blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    scene.fipt.materials.texture_format = suffix[1:].upper()
    assert ops.apply_results() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    shutil.move(blend.parent, tmp_path / "elsewhere")
    shutil.rmtree(scene.fipt.run_folder)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "kitchen.blend"))
    found = {Path(image.filepath).name: image for image in textures(bpy.context.scene)}
    assert set(found) == {
        *(f"Room.001.{name}{suffix}" for name in ("base_color", "confidence", "metallic", "roughness")),
        "environment.exr",
    }
    assert all(image.has_data or image.pixels[0] >= 0.0 for image in found.values())
    assert all(size & (size - 1) == 0 for image in found.values() for size in image.size)
    ops.show_map(shown="ROUGHNESS")
    shown = picture(bpy.context.scene, Vector((0, 5, 4)), Vector((0, 5, 0)))
    assert np.allclose(shown, ConstantFields.roughness, atol=0.01)
    ops.show_map(shown="BASE_COLOR")
    shown = picture(bpy.context.scene, Vector((0, 5, 4)), Vector((0, 5, 0)))
    assert np.allclose(
        shown, [1.055 * value ** (1 / 2.4) - 0.055 for value in ConstantFields.base_color], atol=0.01
    )


def test_textures_of_an_unsaved_file_are_packed_until_it_is_saved(applied, tmp_path):
    assert len(textures(applied)) == 5 and all(image.packed_file for image in textures(applied))
    names = {image.name for image in textures(applied)}
    assert "FIPT Room.001 Base Color" in names
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
    ops.apply_results()
    assert all(image.filepath.startswith("//kitchen_textures") for image in textures(applied))
    assert not any(image.packed_file for image in textures(applied))
    assert {image.name for image in textures(applied)} == names
    applied.fipt.materials.texture_files = "PACKED"
    ops.apply_results()
    assert all(image.packed_file for image in textures(applied))
    applied.fipt.materials.texture_files = "IN_RUN"
    ops.apply_results()
    run = RunFolder(applied.fipt.run_folder).root
    assert all(Path(bpy.path.abspath(image.filepath)).is_relative_to(run) for image in textures(applied))
    assert not any(image.packed_file for image in textures(applied))
    assert {image.name for image in textures(applied)} == names


def test_textures_that_can_not_be_copied_change_nothing(applied, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
    (tmp_path / "kitchen_textures").write_text("a file of that name")
    before = fingerprint(applied)
    assert "'In the File'" in refused(ops.apply_results)
    assert fingerprint(applied) == before


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
    from fipt_blender.blend.results.applying import apply_slices

    before = fingerprint(applied)
    run = RunFolder(applied.fipt.run_folder)
    for count in (1, 2):
        slices = apply_slices(run, applied.fipt.capture.room_objects(applied), applied)
        for _ in range(count):
            next(slices)
        slices.close()
        assert fingerprint(applied) == before


def test_laying_out_does_not_change_a_room_with_results(applied):
    before = fingerprint(applied)
    run = RunFolder(applied.fipt.run_folder)
    objects = applied.fipt.capture.room_objects(applied)
    atlas = run_through(atlas_slices(objects, run, make_settings(changes={"texel_density": 20.0})))
    assert fingerprint(applied) == before and atlas.images


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


def test_damaged_results_are_explained(applied):
    run = RunFolder(applied.fipt.run_folder)
    write_json(run.textures_json, {"images": []})
    run.atlas_npz.write_bytes(b"nothing")
    assert "can't be read" in refused(ops.apply_results)


def eevee() -> str:
    """The identifier of EEVEE in this Blender."""
    return "BLENDER_EEVEE_NEXT" if (4, 2) <= bpy.app.version < (5, 0) else "BLENDER_EEVEE"


def test_apply_switches_to_cycles_and_revert_back(scene):
    assert scene.fipt.materials.use_cycles
    scene.render.engine = "BLENDER_WORKBENCH"
    ops.apply_results()
    assert scene.render.engine == "CYCLES" and not scene.fipt.lights.needs_cycles()
    ops.apply_results()
    ops.revert()
    assert scene.render.engine == "BLENDER_WORKBENCH"
    ops.apply_results()
    scene.render.engine = eevee()
    ops.revert()
    assert scene.render.engine == eevee()  # the artist's last choice


def test_eevee_without_light_is_warned_of(scene):
    scene.fipt.materials.use_cycles = False
    scene.render.engine = eevee()
    ops.apply_results()
    assert scene.render.engine == eevee() and scene.fipt.lights.needs_cycles()
    assert "Switch to Cycles" in refused(ops.make_light_groups)
    ops.fixture_to_area_light(fixture="Fixture.001")  # EEVEE renders Blender lights
    assert not scene.fipt.lights.needs_cycles()
    ops.area_light_to_fixture(fixture="Fixture.001")
    assert ops.use_cycles() == {"FINISHED"} and not scene.fipt.lights.needs_cycles()
    assert ops.make_light_groups() == {"FINISHED"}
    ops.revert()
    assert scene.render.engine == eevee()


def test_new_fixtures_belong_to_the_backdrop(applied):
    ops.set_backdrop(mode="PHOTOGRAPH")
    ops.fixture_to_area_light(fixture="Fixture.001")
    ops.apply_results()
    lamp = bpy.data.objects["Panel"]
    assert lamp.is_shadow_catcher and lamp.children[0].is_shadow_catcher
