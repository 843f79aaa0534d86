"""Renders for comparisons depend on the room, not on the artist's render settings or the names of folders."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender.blend.capture.cameras import find_camera
from fipt_blender.blend.pictures import cycles, image_files
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.blend.save import save_blend
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs.options import MainJobOptions
from fipt_blender.jobs.room_steps import RoomSteps
from samples.at_once import export_room
from samples.rendered_rooms import VIEW, make_scene, photograph

pytestmark = pytest.mark.usefixtures("registered")

OPTIONS = RenderOptions(2, seed=3, denoise=False)


def render(folder: Path) -> np.ndarray:
    path = folder / "render.exr"
    scene = bpy.context.scene
    cycles.render_exr(scene, path, OPTIONS, find_camera(VIEW, scene))
    return image_files.read_pixels(path)


def lit_room(folder: Path) -> bpy.types.Scene:
    """A room with a bright, shiny floor, a sky, and a second view layer that is not rendered."""
    make_scene(folder)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("Sky")
    floor = bpy.data.objects["Floor"].data.materials[0]
    floor.metallic = 1.0
    scene.view_layers.new("Other").use = False
    return scene


def test_no_setting_of_the_artist_changes_the_picture(tmp_path):
    scene = lit_room(tmp_path)
    expected = render(tmp_path)
    assert expected.mean() > 0.01
    image, layer = scene.render.image_settings, scene.view_layers[0]
    values = [
        (scene.cycles, {"samples": 1, "max_bounces": 0, "sample_clamp_direct": 0.01, "film_exposure": 3.0, "seed": 9}),
        (scene.cycles, {"pixel_filter_type": "GAUSSIAN", "use_denoising": True, "film_transparent_glass": True}),
        (scene.render, {"engine": "BLENDER_WORKBENCH", "film_transparent": True, "resolution_percentage": 10}),
        (scene.render, {"use_border": True, "use_crop_to_border": True, "border_max_x": 0.5, "use_simplify": True}),
        (scene.view_settings, {"exposure": 2.0, "gamma": 2.0}),
        (image, {"file_format": "JPEG", "quality": 1}),
        (layer, {"use_pass_combined": False, "samples": 3, "use_sky": False}),
    ]
    for owner, changes in values:
        for name, value in changes.items():
            setattr(owner, name, value)
    np.testing.assert_allclose(render(tmp_path), expected, rtol=1e-4, atol=1e-6)
    assert all(getattr(owner, name) == pytest.approx(value) for owner, row in values for name, value in row.items())


def test_other_view_layers_and_overrides_are_not_rendered(tmp_path):
    scene = lit_room(tmp_path)
    expected = render(tmp_path)
    black = bpy.data.materials.new("Black")
    for layer in scene.view_layers:
        layer.use = True
        layer.material_override = black
        for child in layer.layer_collection.children:
            child.holdout = child.indirect_only = True
    np.testing.assert_array_equal(render(tmp_path), expected)
    assert all(layer.use and layer.material_override == black for layer in scene.view_layers)


# With what Blender's paths, its templates, formats of numbers and shells give a meaning.
NAMES = ("{client} room", "{blend_name}", "a}b{{", "shot.####", "100 %04d", "$HOME~e\u0301 \u90e8\u5c4b;'&.")


@pytest.mark.skipif(os.name != "posix", reason="two slashes are a server's name there")
def test_two_slashes_are_not_the_folder_of_the_blend_file(tmp_path):
    for name in ("run", "a b/{run}", "x//run"):
        run = RunFolder(f"/{tmp_path}/{name}")
        run.renders.mkdir(parents=True)
        write_exr(run.renders / "a.exr", np.ones((2, 3, 3), np.float32))
        assert image_files.read_pixels(run.renders / "a.exr").shape == (2, 3, 3)
        assert (tmp_path / name / "renders" / "a.exr").exists()


@pytest.mark.parametrize("name", NAMES)
def test_the_name_of_a_folder_stops_no_step(tmp_path, name, monkeypatch):
    monkeypatch.setattr(cycles, "can_denoise", lambda: False)
    folder = tmp_path / name
    run = make_scene(folder)
    photo = photograph(run, 4)
    scene = bpy.context.scene
    export_room([bpy.data.objects["Floor"], bpy.data.objects["Wall"]], run)
    list(RoomSteps(MainJobOptions(capture=folder, output=run.root, render_spp=4), run).rerender())
    (entry,) = read_document(run.renders_json, dict)["renders"]
    render = image_files.read_pixels(run.resolve(entry["image"]))
    assert render.mean() == pytest.approx(photo.mean(), rel=0.2)
    save_blend(run.root / "room.blend")
    scene.cycles.samples = 2
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    bpy.ops.fipt.final_picture()
    assert image_files.read_pixels(Path(scene.fipt.insert.picture)).shape == photo.shape
    bpy.ops.wm.open_mainfile(filepath=str(run.root / "room.blend"))
    assert sorted(path.name for path in folder.iterdir()) == ["run"]
    assert not [path for path in tmp_path.iterdir() if path != folder]
