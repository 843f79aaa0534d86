# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of Alembic, USD and FBX files, by Blender's own importers and Use Scene Cameras."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.blend.capture import scene_cameras
from fipt_blender.core import conventions
from fipt_blender.core.run.runfolder import RunFolder

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
