# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's cameras as the capture: exact for every sensor fit; unusable ones are refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.blend.capture import scene_cameras
from fipt_blender.blend.capture.exporting import camera_pose
from fipt_blender.blend.marks import LARGE_PHOTOGRAPH, PIXEL_ASPECT, RESOLUTION
from fipt_blender.core import conventions
from fipt_blender.core.run.runfolder import RunFolder
from samples.camera_views import points_before, projections
from samples.refusals import error_of

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene():
    return bpy.context.scene


def photograph(path: Path, width: int, height: int, form: str = "OPEN_EXR") -> bpy.types.Image:
    image = bpy.data.images.new(path.stem, width, height, float_buffer=form == "OPEN_EXR")
    image.filepath_raw, image.file_format = str(path), form
    image.save()
    return image


def own_camera(scene, path: Path, size: tuple[int, int], **lens) -> bpy.types.Object:
    item = bpy.data.objects.new(path.stem, bpy.data.cameras.new(path.stem))
    scene.collection.objects.link(item)
    for name, value in lens.items():
        setattr(item.data, name, value)
    item.matrix_world = Matrix.LocRotScale((0.4, 1.0, 1.6), Euler((1.3, 0.1, 0.7)), None)
    background = item.data.background_images.new()
    background.image = photograph(path, *size)
    background.frame_method = "STRETCH"
    return item


def frames(path: Path) -> dict[str, dict]:
    return {frame["name"]: frame for frame in json.loads(path.read_text())["frames"]}


LENSES = {
    "horizontal": dict(sensor_fit="HORIZONTAL", lens=31.0, shift_x=0.1, shift_y=-0.07),
    "vertical": dict(sensor_fit="VERTICAL", lens=24.0, sensor_height=30.0, shift_x=-0.2),
    "auto": dict(sensor_fit="AUTO", lens=40.0, sensor_width=30.0, shift_y=0.15),
}


@pytest.mark.parametrize("size", [(96, 64), (64, 96)])
@pytest.mark.parametrize("aspect", [(1.0, 1.0), (1.0, 1.5), (2.0, 1.0)])
@pytest.mark.parametrize("lens", LENSES)
def test_cameras_of_the_scene_project_as_blender_does(scene, tmp_path, size, aspect, lens):
    """Against Blender's own projection matrix, for each sensor fit, shift, pixel aspect and orientation."""
    run = RunFolder(tmp_path / "run")
    render = scene.render
    render.resolution_x, render.resolution_y = size
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    item = own_camera(scene, tmp_path / "photo.exr", size, **LENSES[lens])
    bpy.context.view_layer.update()
    path, left_out = scene_cameras.write_scene_cameras(scene, run)
    frame = frames(path)["photo"]
    pose = conventions.opengl_to_opencv_camera(np.array(frame["transform_matrix"]))
    entry = {"width": frame["w"], "height": frame["h"], "fx": frame["fl_x"], "fy": frame["fl_y"]}
    entry |= {"cx": frame["cx"], "cy": frame["cy"], "camera_to_world": pose}
    points = points_before(entry)
    matrix = np.array(
        item.calc_matrix_camera(
            bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1], scale_x=aspect[0], scale_y=aspect[1]
        ),
        np.float64,
    ) @ np.linalg.inv(np.array(item.matrix_world, np.float64))
    clip = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    blender = (clip[:, :2] / clip[:, 3:] * [0.5, -0.5] + 0.5) * size
    assert np.abs(projections(entry, points) - blender).max() < 1e-4 and not left_out


def test_a_photograph_with_another_aspect_than_the_frame(scene, tmp_path):
    """64 x 64 in a frame of 128 x 64: fit keeps its height, crop its width, stretch both."""
    scene.render.resolution_x, scene.render.resolution_y = 128, 64
    item = own_camera(scene, tmp_path / "square.exr", (64, 64), lens=36.0, sensor_width=36.0)
    background = item.data.background_images[0]
    expected = {"FIT": (128.0, 128.0), "CROP": (64.0, 64.0), "STRETCH": (64.0, 128.0)}
    for method, focal in expected.items():
        background.frame_method = method
        frame = scene_cameras.describe_camera(scene, item)
        assert (frame["fl_x"], frame["fl_y"]) == pytest.approx(focal)
        assert (frame["cx"], frame["cy"]) == pytest.approx((32.0, 32.0))


def test_unusable_cameras_are_refused(scene, tmp_path):
    run = RunFolder(tmp_path / "run")

    def code() -> str:
        return error_of(scene_cameras.write_scene_cameras, scene, run).code

    assert code() == "cameras-none"
    bare = bpy.data.objects.new("bare", bpy.data.cameras.new("bare"))
    scene.collection.objects.link(bare)
    assert code() == "cameras-none"
    item = own_camera(scene, tmp_path / "photo.exr", (32, 16))
    background = item.data.background_images[0]
    assert scene_cameras.write_scene_cameras(scene, run)[1] == ["bare"]
    background.offset[0] = 0.2
    assert code() == "background-moved"
    background.offset[0] = 0.0
    background.use_flip_x = True
    assert code() == "background-moved"
    background.use_flip_x = False
    item.data.type = "ORTHO"
    assert code() == "camera-model"
    item.data.type = "PERSP"
    good = background.image
    background.image = bpy.data.images.new("generated", 32, 16, float_buffer=True)
    assert code() == "image-missing"
    background.image = good
    parent = bpy.data.objects.new("parent", None)
    scene.collection.objects.link(parent)
    parent.scale = (1.0, 1.0, 3.0)
    item.parent = parent
    assert code() == "alignment-uneven"


def test_photographs_that_are_not_hdr_are_taken(scene, tmp_path):
    item = own_camera(scene, tmp_path / "photo.exr", (32, 16))
    item.data.background_images[0].image = photograph(tmp_path / "photo.jpg", 32, 16, "JPEG")
    path, skipped = scene_cameras.write_scene_cameras(scene, RunFolder(tmp_path / "run"))
    assert frames(path)["photo"]["file_path"].endswith("photo.jpg") and skipped == []


def test_pose_of_a_constrained_camera_is_the_evaluated_one(scene):
    target = bpy.data.objects.new("target", None)
    item = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    for each in (target, item):
        scene.collection.objects.link(each)
    target.location = (5.0, 0.0, 0.0)
    constraint = item.constraints.new("TRACK_TO")
    constraint.target, constraint.track_axis, constraint.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    bpy.context.view_layer.update()
    assert np.allclose(camera_pose(item)[:3, 2], [1.0, 0.0, 0.0], atol=1e-6)
    assert math.isclose(np.linalg.det(camera_pose(item)[:3, :3]), 1.0, abs_tol=1e-9)


def test_a_small_copy_stands_for_its_photograph(scene, tmp_path):
    item = own_camera(scene, tmp_path / "small.exr", (12, 6), **LENSES["horizontal"])
    item.data.background_images[0].image[LARGE_PHOTOGRAPH] = str(tmp_path / "large.exr")
    photograph(tmp_path / "large.exr", 48, 24)
    item[RESOLUTION], item[PIXEL_ASPECT] = (48, 24), (1.0, 1.0)
    frame = scene_cameras.describe_camera(scene, item)
    assert (frame["file_path"], frame["w"], frame["h"]) == (str(tmp_path / "large.exr"), 48, 24)
