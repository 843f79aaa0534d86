# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The comparison of photograph and render; tests/gui drags its divider in a window."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender.blend.capture import compare
from fipt_blender.blend.pictures import image_files
from samples.operator_calls import refused
from samples.rendered_rooms import SIZE, VIEW, make_scene

pytestmark = pytest.mark.usefixtures("registered")

WIDTH, HEIGHT = SIZE


@pytest.fixture
def scene(tmp_path):
    """A view whose photograph is 2 and whose render is 0.5 everywhere."""
    run = make_scene(tmp_path)
    scene = bpy.context.scene
    for background in scene.camera.data.background_images:
        image_files.save_exr(Path(background.image.filepath_from_user()), np.full((HEIGHT, WIDTH, 3), 2.0, np.float32))
        background.image.reload()
    render = run.renders / "rerender" / "val_000.exr"
    image_files.save_exr(render, np.full((HEIGHT // 2, WIDTH // 2, 3), 0.5, np.float32))
    entry = scene.fipt.check.views.add()
    entry.name, entry.render = VIEW, str(render)
    return scene


def shown(scene: bpy.types.Scene) -> np.ndarray:
    """What lies over the scene's camera (H,W,4)."""
    (background,) = scene.camera.data.background_images
    image = background.image
    assert image.name == compare.NAME and image.use_view_as_render and background.display_depth == "FRONT"
    assert background.alpha == 1.0 and scene.camera.data.show_background_images
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def test_the_divider_parts_photograph_and_render(scene):
    photograph = scene.camera.data.background_images[0].image
    scene.fipt.check.divider = 0.25
    assert bpy.ops.fipt.compare(mode="RENDER") == {"FINISHED"}
    picture = shown(scene)
    assert np.allclose(picture[:, :8], (2.0, 2.0, 2.0, 1.0)) and np.allclose(picture[:, 8:], (0.5, 0.5, 0.5, 1.0))
    scene.fipt.check.divider = 1.0
    assert np.allclose(shown(scene), (2.0, 2.0, 2.0, 1.0))
    assert bpy.ops.fipt.compare(mode="VIEWPORT") == {"FINISHED"}
    scene.fipt.check.divider = 0.5
    assert (shown(scene)[:, 16:] == 0.0).all(), "the viewport is seen there"
    assert bpy.ops.fipt.compare(toggle=True) == {"FINISHED"} and scene.fipt.check.compare == "OFF"
    assert scene.camera.data.background_images[0].image == photograph
    assert compare.NAME not in bpy.data.images and compare.compared_camera(scene) == ""


def test_the_comparison_follows_the_view_and_ends_where_it_cannot(scene):
    assert bpy.ops.fipt.compare(mode="RENDER") == {"FINISHED"}
    bpy.ops.fipt.look_through(step=1)  # this view has no render
    assert scene.fipt.check.compare == "OFF" and compare.NAME not in bpy.data.images
    assert "no render of the view 'train/000'" in refused(bpy.ops.fipt.compare, mode="RENDER")
    assert bpy.ops.fipt.compare(mode="VIEWPORT") == {"FINISHED"}
    bpy.ops.fipt.look_through(step=1)
    assert compare.compared_camera(scene) == scene.camera.name == VIEW
    scene.fipt.capture.photograph_opacity = 0.3
    assert shown(scene).any()


def test_files_are_saved_without_the_comparison(scene, tmp_path):
    bpy.ops.fipt.compare(mode="VIEWPORT")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert scene.fipt.check.compare == "OFF" and compare.NAME not in bpy.data.images
    bpy.ops.fipt.compare(mode="VIEWPORT")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    scene = bpy.context.scene
    assert scene.fipt.check.compare == "OFF" and compare.compared_camera(scene) == ""
    assert bpy.ops.fipt.compare(mode="VIEWPORT") == {"FINISHED"}


def test_codes_are_compared_as_radiance(tmp_path):
    image = bpy.data.images.new("codes", 4, 4)
    image.pixels.foreach_set(np.full(64, 188.0 / 255.0, np.float32))
    assert np.allclose(compare.pixels_of(image)[..., :3], 0.503, atol=2e-3)
