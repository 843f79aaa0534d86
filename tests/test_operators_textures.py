"""Where textures of applied results are: beside the file, in the run until it has a name."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.collecting import missing_pictures
from fipt_blender.blend.image_datablocks import image_values, linear_values
from fipt_blender.core.run.run_files import PANES, read_room
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import running
from samples import artist
from samples.applied_rooms import ConstantFields, fingerprint, picture
from samples.made_rooms import with_panes
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


def test_a_scan_that_has_got_other_surfaces_gets_other_texture_coordinates(scene):
    run = RunFolder(scene.fipt.run_folder)
    assert ops.apply_results() == {"FINISHED"} and PANES not in bpy.data.objects
    with_panes(run)  # an estimate with other settings has found them
    run.fields_npz.write_bytes(b"estimated again")
    assert ops.apply_results() == {"FINISHED"} and PANES in bpy.data.objects
    with np.load(run.atlas_npz) as atlas:
        assert len(atlas["triangle_image"]) == len(read_room(run).triangles)


@pytest.mark.parametrize(("change", "suffix"), [("open", "EXR"), ("undo", "PNG"), ("undo", "EXR"), ("save", "PNG")])
def test_a_file_shows_the_results_that_it_was_saved_with(scene, tmp_path, monkeypatch, change, suffix):
    blend = str(tmp_path / "kitchen.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    settings = scene.fipt.materials
    settings.texture_format = suffix

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


def paths(scene) -> set[str]:
    return {image.filepath for image in textures(scene)}


@pytest.mark.parametrize(("relative", "suffix"), [(True, "EXR"), (False, "PNG")])
def test_the_first_save_brings_the_textures_beside_the_file(scene, tmp_path, relative, suffix):
    run = Path(scene.fipt.run_folder)
    settings = scene.fipt.materials
    settings.texture_format, settings.texture_size = suffix, "512"
    settings.texel_density = 128.0
    ops.apply_results()
    before = paths(scene)
    assert len(before) > 5 and all(Path(path).is_relative_to(run) for path in before)
    values = [image_values(image) for image in textures(scene)]
    # A copy has textures of its own; the open file keeps those that it has.
    (tmp_path / "copy").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy" / "kitchen.blend"), copy=True)
    assert paths(scene) == before and not bpy.data.filepath
    blend = tmp_path / "shot" / "kitchen.blend"
    blend.parent.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), relative_remap=relative)
    start = "//" if relative else f"{blend.parent}/"  # as the artist's preference for relative paths
    assert all(path.startswith(f"{start}kitchen_textures/") for path in paths(bpy.context.scene))
    shutil.rmtree(run)
    for folder in ("shot", "copy") if relative else ("copy",):
        shutil.move(tmp_path / folder, tmp_path / f"{folder} moved")
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / f"{folder} moved" / "kitchen.blend"))
        assert not missing_pictures() and all(path.startswith("//") for path in paths(bpy.context.scene))
        images = textures(bpy.context.scene)
        assert all(np.array_equal(image_values(image), old) for image, old in zip(images, values, strict=True))
    shutil.rmtree(tmp_path / "copy moved" / "kitchen_textures")
    assert len(missing_pictures()) == len(before)


@pytest.mark.parametrize("copy", [False, True])
def test_textures_can_be_read_while_a_file_gets_its_first_name(applied, tmp_path, copy):
    """As by the thumbnail that Blender draws: it doesn't try again to read an image that it has failed to read."""
    images = textures(applied)
    for image in images:
        image.buffers_free()
    sizes = []

    def draw(*_: object) -> None:
        sizes.extend(tuple(image.size) for image in images)

    bpy.app.handlers.save_pre.append(draw)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"), copy=copy)
    finally:
        bpy.app.handlers.save_pre.remove(draw)
    assert len(sizes) == len(images) and (0, 0) not in sizes
    assert all(image_values(image).size for image in images)


def test_what_reads_textures_changes_nothing_where_one_is_missing(applied, tmp_path):
    cube = bpy.data.objects["cube"]
    cube.select_set(True)
    image = next(each for each in textures(applied) if "Base Color" in each.name)
    path = Path(image.filepath)
    path.rename(tmp_path / "elsewhere.exr")
    image.buffers_free()
    (tmp_path / "out").mkdir()
    for call in (ops.remove_from_room, lambda: ops.export_room(filepath=str(tmp_path / "out" / "room.gltf"))):
        for content in (None, b"no picture"):
            if content:
                path.write_bytes(content)
            before = fingerprint(applied)
            assert path.name in refused(call)
            assert fingerprint(applied) == before and not list((tmp_path / "out").iterdir())
            path.unlink(missing_ok=True)
    (tmp_path / "elsewhere.exr").rename(path)  # Blender has failed to read it
    assert ops.remove_from_room() == {"FINISHED"}


def test_a_file_whose_textures_can_not_be_copied_is_saved_all_the_same(applied, tmp_path, capfd):
    before = paths(applied)
    (tmp_path / "kitchen_textures").write_text("a file of that name")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"), relative_remap=False)
    assert paths(applied) == before and "could not be copied" in capfd.readouterr().out
    assert (tmp_path / "kitchen.blend").is_file()
    # A file that has a name brings what is still in the run folder when it is saved again, under no other name.
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"), copy=True)
    (tmp_path / "kitchen_textures").unlink()
    assert paths(bpy.context.scene) == before and not (tmp_path / "other_textures").exists()
    bpy.ops.wm.save_mainfile()
    assert all(path.startswith("//kitchen_textures/") for path in paths(bpy.context.scene)) and not missing_pictures()


def test_textures_that_can_not_be_copied_change_nothing(applied, tmp_path):
    (tmp_path / "kitchen_textures").write_text("a file of that name")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
    before = fingerprint(applied)
    assert "Free some space" in refused(ops.apply_results)
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
