# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender cameras project like the views' pinholes."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from fipt_blender.blend.capture import cameras
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.camera_views import random_views


@pytest.fixture
def run(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.create(make_settings())
    files = {"image": "images/a.exr", "parts": None, "semantics": None}
    views = [{**view, **files} for view in random_views()]
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    data = {**head, "world_from_source": np.eye(4).tolist(), "views": views}
    write_json(folder.capture_json, data)
    image = bpy.data.images.new("a", 192, 108, float_buffer=True)
    folder.images.mkdir()
    image.filepath_raw, image.file_format = str(folder.images / "a.exr"), "OPEN_EXR"
    image.save()
    bpy.data.images.remove(image)
    folder.views = views
    return folder


def test_projection_agrees_with_the_pinhole(run):
    scene = bpy.context.scene
    cameras.add_cameras(run, scene)
    random = np.random.default_rng(0)
    for view in run.views:
        camera = cameras.find_camera(view["name"], scene)
        cameras.use_view(scene, camera)
        bpy.context.view_layer.update()
        assert (scene.render.resolution_x, scene.render.resolution_y) == (view["width"], view["height"])
        pose = np.array(view["camera_to_world"])
        pixels = random.uniform(0, 1, (50, 2)) * [view["width"], view["height"]]
        rays = np.column_stack(
            [(pixels[:, 0] - view["cx"]) / view["fx"], (pixels[:, 1] - view["cy"]) / view["fy"], np.ones(50)]
        )
        points = (rays * random.uniform(1, 3, (50, 1))) @ pose[:3, :3].T + pose[:3, 3]
        for point, pixel in zip(points, pixels, strict=True):
            x, y, depth = world_to_camera_view(scene, camera, Vector(point))
            projected = np.array([x * view["width"], (1.0 - y) * view["height"]])
            assert depth > 0
            # Blender keeps single precision: 1e-4 pixels is two parts in a million of the width.
            assert np.abs(projected - pixel).max() < 1e-4
        # world_to_camera_view is not what the renderer uses: check the projection matrix too.
        matrix = np.array(
            camera.calc_matrix_camera(
                bpy.context.evaluated_depsgraph_get(), x=view["width"], y=view["height"],
                scale_x=scene.render.pixel_aspect_x, scale_y=scene.render.pixel_aspect_y,
            ),
            np.float64,
        ) @ np.linalg.inv(np.array(camera.matrix_world, np.float64))  # fmt: skip
        clip = np.column_stack([points, np.ones(50)]) @ matrix.T
        ndc = clip[:, :2] / clip[:, 3:]
        projected = (ndc * [0.5, -0.5] + 0.5) * [view["width"], view["height"]]
        assert np.abs(projected - pixels).max() < 1e-4


def test_cameras_show_photographs_and_are_not_duplicated(run):
    names = cameras.add_cameras(run)
    assert cameras.add_cameras(run) == names
    assert len(bpy.data.objects) == len(run.views)
    camera = bpy.data.objects[names[0]]
    assert camera["fipt_split"] == "held_back"
    assert [each.name for each in camera.users_collection] == ["FIPT Cameras"]
    image = camera.data.background_images[0].image
    assert image.is_float and image.colorspace_settings.name == "Linear Rec.709"
    assert len(bpy.data.images) == 1


def test_unknown_view(run):
    with pytest.raises(FiptError) as error:
        cameras.find_camera("train/none", bpy.context.scene)
    assert error.value.code == "view-missing"
