# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where textures of applied results are: beside the file, in it, or in the run."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.collecting import missing_pictures, pictures_elsewhere
from fipt_blender.blend.image_datablocks import image_values, linear_values
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running
from samples import artist
from samples.applied_rooms import ConstantFields, fingerprint, picture
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


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
    (folder,) = {Path(name).parent.name for name in names}
    assert names == [
        *(f"//kitchen_textures/{folder}/Room.001.{name}.exr" for name in maps),
        f"//kitchen_textures/{folder}/environment.exr",
    ]
    sizes = {image.size[:] for image in textures(scene)}
    scene.fipt.materials.texel_density = 64.0
    assert ops.apply_results() == {"FINISHED"}
    assert sizes != {image.size[:] for image in textures(scene)}  # the copies are the new ones


@pytest.mark.parametrize(
    ("keep", "change", "suffix"),
    [
        ("BESIDE", "open", "EXR"),
        ("BESIDE", "undo", "PNG"),
        ("PACKED", "undo", "EXR"),
        ("PACKED", "save", "PNG"),
        ("IN_RUN", "undo", "EXR"),
        ("IN_RUN", "save", "PNG"),
    ],
)
def test_a_file_shows_the_results_that_it_was_saved_with(scene, tmp_path, monkeypatch, keep, change, suffix):
    blend = str(tmp_path / "kitchen.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    settings = scene.fipt.materials
    settings.texture_files, settings.texture_format = keep, suffix

    def shown() -> float:
        (image,) = (each for each in textures(bpy.context.scene) if "Base Color" in each.name)
        return float(linear_values(image)[..., 0].max())

    assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}
    before = shown()
    if change == "save":  # the copy of an earlier state
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "earlier.blend"), copy=True)
        blend = str(tmp_path / "earlier.blend")
    else:
        bpy.ops.wm.save_mainfile()
    bpy.ops.ed.undo_push(message="before")
    monkeypatch.setattr(ConstantFields, "base_color", (0.9, 0.3, 0.1))
    run = RunFolder(scene.fipt.run_folder)
    run.fields_npz.write_bytes(b"estimated again")
    assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}
    assert shown() > before + 0.2
    if change == "undo":
        bpy.ops.ed.undo()
    else:
        bpy.ops.wm.open_mainfile(filepath=blend)
    assert shown() == before


def test_a_moved_file_finds_its_textures(scene, tmp_path):
    blend = tmp_path / "shot" / "kitchen.blend"
    blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    scene.fipt.materials.texture_format = "PNG"
    assert ops.apply_results() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    shutil.move(blend.parent, tmp_path / "elsewhere")
    shutil.rmtree(scene.fipt.run_folder)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "kitchen.blend"))
    found = {Path(image.filepath).name: image for image in textures(bpy.context.scene)}
    assert set(found) == {
        *(f"Room.001.{name}.png" for name in ("base_color", "confidence", "metallic", "roughness")),
        "environment.exr",
    }
    assert all(image.has_data or image.pixels[0] >= 0.0 for image in found.values())
    assert all(size & (size - 1) == 0 for image in found.values() for size in image.size)
    ops.show_map(shown="ROUGHNESS")
    shown = picture(bpy.context.scene, Vector((0, 5, 4)), Vector((0, 5, 0)))
    assert np.allclose(shown, ConstantFields.roughness, atol=0.01)
    ops.show_map(shown="BASE_COLOR")
    shown = picture(bpy.context.scene, Vector((0, 5, 4)), Vector((0, 5, 0)))
    assert np.allclose(shown, [1.055 * value ** (1 / 2.4) - 0.055 for value in ConstantFields.base_color], atol=0.01)


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


@pytest.mark.parametrize(("density", "mode"), [(16.0, "uv"), (32.0, "uv"), (16.0, "color_attribute")])
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


def test_a_changed_modifier_stays_live_on_the_results(applied):
    """Of an object with other faces than those that were estimated."""
    cube = bpy.data.objects["cube"]
    ops.show_map(shown="ORIGINAL")
    cube.modifiers["Bevel"].segments = 3
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert cube.modifiers["Bevel"].show_viewport and len(cube.data.polygons) == 6
    assert {slot.material.name for slot in cube.material_slots} == {"Cube FIPT"}
    cube.modifiers["Bevel"].segments = 1
    ops.show_map(shown="ORIGINAL")
    ops.show_map(shown="ESTIMATED")
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert not cube.modifiers["Bevel"].show_viewport and len(cube.data.polygons) == 26
    ops.revert()
    assert cube.modifiers["Bevel"].show_viewport and not marks.has_results(cube)


def test_a_room_of_which_nothing_is_left_is_refused(scene):
    for name in ("panel", "cube"):
        mesh = bpy.data.objects[name].data
        mesh.transform(Matrix.Translation((50.0, 0.0, 0.0)))
        artist.subdivide(name)
    before = fingerprint(scene)
    assert "No face" in refused(ops.apply_results)
    assert fingerprint(scene) == before


def test_objects_are_found_by_their_ids_not_by_the_names_of_others(applied):
    cube, panel = bpy.data.objects["cube"], bpy.data.objects["panel"]
    cube.name, panel.name = "aside", "cube"
    cube.name = "panel"
    copy = panel.copy()  # with its id
    bpy.data.collections["Parts"].objects.link(copy)
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert len(cube.data.polygons) > 6 and len(panel.data.polygons) == 2


def test_runs_without_ids_match_by_name(scene):
    run = RunFolder(scene.fipt.run_folder)
    names = read_document(run.room_json, dict)
    assert names.pop("object_ids") == ["panel", "cube"]
    write_json(run.room_json, names)
    for item in scene.objects:
        marks.remove_marks(item, marks.OBJECT_ID)
    assert ops.apply_results() == {"FINISHED"} and not warned()
    bpy.data.objects["panel"].name = "wall"  # applying gave it an id
    assert ops.apply_results() == {"FINISHED"} and not warned()
    assert len(bpy.data.objects["wall"].data.polygons) == 2


@pytest.mark.parametrize(("pack", "suffix", "tiled"), [(False, "EXR", True), (True, "EXR", False), (True, "PNG", True)])
def test_a_file_saved_elsewhere_collects_its_pictures(scene, tmp_path, pack, suffix, tiled):
    first, second = tmp_path / "first" / "room.blend", tmp_path / "second" / "shot.blend"
    for blend in (first, second):
        blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(first))
    scene = bpy.context.scene
    settings = scene.fipt.materials
    settings.texture_format, settings.texture_size = suffix, "512"
    settings.texel_density = 128.0 if tiled else 8.0
    ops.apply_results()
    assert {image.source == "TILED" for image in textures(scene) if image.name != "FIPT World"} == {tiled}
    bpy.ops.wm.save_mainfile()
    assert not missing_pictures() and not pictures_elsewhere()
    bpy.ops.wm.save_as_mainfile(filepath=str(second))
    assert pictures_elsewhere() == 5 and not missing_pictures()
    assert ops.collect_pictures(pack=pack) == {"FINISHED"}
    assert not pictures_elsewhere() and second.with_name("shot_textures").exists() != pack
    bpy.ops.wm.save_mainfile()
    before = [image_values(image) for image in textures(scene) if image.source != "TILED"]
    shutil.rmtree(scene.fipt.run_folder)
    shutil.move(second.parent, tmp_path / "third")
    # The first file has lost nothing.
    bpy.ops.wm.open_mainfile(filepath=str(first))
    assert not missing_pictures()
    shutil.rmtree(first.parent)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "third" / "shot.blend"))
    assert not missing_pictures() and not pictures_elsewhere()
    images = [image for image in textures(bpy.context.scene) if image.source != "TILED"]
    assert all(np.array_equal(image_values(image), old) for image, old in zip(images, before, strict=True))
    if not pack:
        shutil.rmtree(tmp_path / "third" / "shot_textures")
        assert len(missing_pictures()) == (9 if tiled else 5)
        assert "missing" in refused(ops.collect_pictures)
