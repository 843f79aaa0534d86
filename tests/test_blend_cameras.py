# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender cameras project like the views' pinholes."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from fipt_blender.blend.capture import cameras, scene_cameras
from fipt_blender.core import conventions
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


pytestmark = pytest.mark.usefixtures("registered")
SIZE = (96, 64)
LENSES = {"Wide": (24.0, 36.0, 0.0, 0.0), "Shifted": (35.0, 32.0, 0.05, -0.08)}


def export(kind: str, path: Path) -> None:
    if kind == "abc":
        bpy.ops.wm.alembic_export(filepath=str(path), start=1, end=1)
    elif kind == "usd":
        bpy.ops.wm.usd_export(filepath=str(path), export_cameras=True)
    else:
        bpy.ops.preferences.addon_enable(module="io_scene_fbx")
        bpy.ops.export_scene.fbx(filepath=str(path), object_types={"CAMERA", "EMPTY"})


def bring_in(kind: str, path: Path) -> None:
    if kind == "abc":
        bpy.ops.wm.alembic_import(filepath=str(path), as_background_job=False)
    elif kind == "usd":
        bpy.ops.wm.usd_import(filepath=str(path), import_cameras=True)
    else:
        bpy.ops.import_scene.fbx(filepath=str(path))


def photograph(folder: Path) -> bpy.types.Image:
    image = bpy.data.images.new("photo", *SIZE, float_buffer=True)
    image.filepath_raw, image.file_format = str(folder / "photo.exr"), "OPEN_EXR"
    image.save()
    return image


def written(folder: Path) -> list[dict]:
    """What Use Scene Cameras writes of the scene's cameras, by name."""
    for item in bpy.context.scene.objects:
        if item.type == "CAMERA":
            background = item.data.background_images.new()
            background.image, background.frame_method = photograph(folder), "STRETCH"
    bpy.context.view_layer.update()
    path, skipped = scene_cameras.write_scene_cameras(bpy.context.scene, RunFolder(folder))
    assert not skipped
    return sorted(json.loads(path.read_text())["frames"], key=lambda frame: frame["fl_x"])


@pytest.mark.parametrize("kind", ["abc", "usd", "fbx"])
def test_cameras_survive_the_file(tmp_path: Path, kind: str) -> None:
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    truth = {}
    for index, (name, (lens, sensor, shift_x, shift_y)) in enumerate(LENSES.items()):
        item = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        scene.collection.objects.link(item)
        item.matrix_world = Matrix.LocRotScale((0.4 + index, -1.0, 1.6), Euler((1.3, 0.1, 0.7 + index)), None)
        camera = item.data
        camera.lens, camera.sensor_width, camera.sensor_height = lens, sensor, sensor * SIZE[1] / SIZE[0]
        camera.shift_x, camera.shift_y = shift_x, shift_y
        focal = lens / sensor * SIZE[0]
        centre = (0.5 * SIZE[0] - shift_x * SIZE[0], 0.5 * SIZE[1] + shift_y * SIZE[0])
        truth[focal] = (np.array(item.matrix_world), centre)
    bpy.context.view_layer.update()
    path = tmp_path / f"cameras.{kind}"
    export(kind, path)
    for item in list(scene.objects):
        bpy.data.objects.remove(item)
    bring_in(kind, path)
    frames = written(tmp_path)
    assert len(frames) == len(LENSES)
    for frame, (focal, (matrix, centre)) in zip(frames, sorted(truth.items()), strict=True):
        np.testing.assert_allclose([frame["fl_x"], frame["fl_y"]], focal, rtol=0, atol=1e-4)
        np.testing.assert_allclose([frame["cx"], frame["cy"]], centre, rtol=0, atol=1e-4)
        found = conventions.opengl_to_opencv_camera(np.array(frame["transform_matrix"]))
        np.testing.assert_allclose(found, conventions.blender_to_opencv_camera(matrix), atol=1e-5)
