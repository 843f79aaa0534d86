"""Collect Room: a copy that opens on another machine, without the add-on and without the first files."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

import fipt_blender
from fipt_blender.blend.image_datablocks import image_values
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


def means() -> dict[str, float | None]:
    """The mean of each image of the open file, or None where it is missing."""
    images = [image for image in bpy.data.images if image.source in ("FILE", "TILED")]
    return {image.name: float(np.mean(image.pixels[:])) if image.size[0] else None for image in images}


def own_image(path: Path, color: float) -> bpy.types.Image:
    path.parent.mkdir(exist_ok=True)
    image = bpy.data.images.new(path.stem, 4, 4)
    image.pixels[:] = [color] * 64
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)
    image = bpy.data.images.load(str(path))
    image.name, image.use_fake_user = f"{path.parent.name} {path.stem}", True
    return image


def state() -> dict[str, tuple[object, ...]]:
    return {image.name: (image.filepath, image.packed_file is None, image.is_dirty) for image in bpy.data.images}


def test_a_collected_room_opens_elsewhere(scene, tmp_path):
    first, target = tmp_path / "first", tmp_path / "second" / "room"
    first.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(first / "shot.blend"))
    settings = bpy.context.scene.fipt.materials
    settings.texture_size = "512"
    settings.texel_density = 128.0  # several images
    assert ops.apply_results() == {"FINISHED"}
    for index, place in enumerate((tmp_path / "a" / "wood", tmp_path / "b" / "wood", first / "2-wood")):
        place.parent.mkdir(exist_ok=True)
        own_image(place / "oak.png", 0.25 * (index + 1)).name = f"oak {index}"
    tiled = own_image(tmp_path / "a" / "wall.1001.png", 0.5)
    tiled.source, tiled.filepath = "TILED", str(tmp_path / "a" / "wall.<UDIM>.png")
    bpy.ops.wm.save_mainfile()
    before, saved = state(), (first / "shot.blend").read_bytes()
    shown = means()
    assert len(shown) > 5 and {f"oak {index}" for index in range(3)} <= set(shown)
    assert ops.collect_room(directory=str(target)) == {"FINISHED"}
    assert state() == before and (first / "shot.blend").read_bytes() == saved
    assert ops.collect_room(directory=str(target)) == {"FINISHED"}  # in a folder of its own
    assert "exists" in refused(ops.collect_room, directory=str(target))
    assert (target / "shot_collected" / "shot.blend").is_file()
    shutil.rmtree(target / "shot_collected")
    assert sorted(path.name for path in target.iterdir()) == ["shot.blend", "shot_textures"]
    shutil.rmtree(bpy.context.scene.fipt.run_folder)
    for folder in (first, tmp_path / "a", tmp_path / "b"):
        shutil.rmtree(folder)
    shutil.move(target, tmp_path / "third")
    fipt_blender.unregister()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "third" / "shot.blend"))
        assert means() == pytest.approx(shown)
    finally:
        fipt_blender.register()
    paths = {image.filepath for image in bpy.data.images} - {""}  # images that are only packed have none
    assert all(path.startswith("//shot_textures/") for path in paths)


def test_what_was_painted_comes_along(applied, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    image = own_image(tmp_path / "wood" / "oak.png", 0.25)
    image.pixels[:] = [1.0] * 64
    assert image.is_dirty
    assert ops.collect_room(directory=str(tmp_path / "out")) == {"FINISHED"}
    assert image_values(image).min() == 1.0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "shot.blend"))
    assert image_values(bpy.data.images["wood oak"]).min() == 1.0


def test_what_can_not_be_collected_is_said(applied, tmp_path, capfd):
    before = state()
    assert ops.collect_room(directory=str(tmp_path / "unsaved")) == {"FINISHED"}
    assert (tmp_path / "unsaved" / "room.blend").is_file() and not bpy.data.filepath and state() == before
    (textures,) = (tmp_path / "unsaved" / "room_textures").iterdir()
    assert len(list(textures.iterdir())) == 5
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    image = own_image(tmp_path / "wood" / "gone.png", 0.25)
    shutil.rmtree(tmp_path / "wood")
    assert ops.collect_room(directory=str(tmp_path / "out")) == {"FINISHED"}
    assert "gone.png" in capfd.readouterr().out and image.filepath
