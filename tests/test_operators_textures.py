# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where textures of applied results are: beside the file, in it, or in the run."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

from fipt_blender.blend import marks
from fipt_blender.core.run.runfolder import RunFolder
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
