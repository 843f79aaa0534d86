"""The artist's cameras as the capture: exact for every sensor fit; unusable ones are refused."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from fipt_blender.blend.capture import cameras, scene_cameras
from fipt_blender.blend.capture.cameras import camera_pose
from fipt_blender.blend.capture.exporting import export_capture
from fipt_blender.blend.marks import LARGE_PHOTOGRAPH, PIXEL_ASPECT, RESOLUTION
from fipt_blender.core import conventions
from fipt_blender.core.run.runfolder import RunFolder, write_json
from samples.camera_views import points_before, projections
from samples.refusals import error_of

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene():
    return bpy.context.scene


@pytest.fixture
def run(tmp_path):
    return RunFolder(tmp_path / "run")


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


PHOTOGRAPHS = {"landscape": (400, 300), "portrait": (267, 400), "wide": (410, 111), "square": (150, 150)}


def scene_projection(scene, item, points) -> np.ndarray:
    """(N, 2) places of world points in the frame that Blender renders: 0 to 1 to the right and down."""
    found = np.array([world_to_camera_view(scene, item, Vector(point)) for point in points])
    assert (found[:, 2] > 0).all()
    return np.column_stack([found[:, 0], 1.0 - found[:, 1]])


def lies_in_photograph(scene, item, places, size) -> np.ndarray:
    """(N, 2) pixels of the photograph at places of the frame, as Blender lays the image over the frame."""
    render, background = scene.render, item.data.background_images[0]
    across = render.resolution_x * render.pixel_aspect_x
    down = render.resolution_y * render.pixel_aspect_y
    aspect = size[0] * background.image.display_aspect[0] / (size[1] * background.image.display_aspect[1])
    width, height = across, down
    if background.frame_method != "STRETCH":
        if (aspect > across / down) == (background.frame_method == "FIT"):
            height = across / aspect
        else:
            width = down * aspect
    shares = (places - 0.5) * [across, down] / [width, height] + 0.5
    return shares * size


def written(scene, run) -> dict[str, dict]:
    """Frames that Use Scene Cameras writes, as entries of capture.json, by the camera's name."""
    entries = {}
    for name, frame in frames(scene_cameras.write_scene_cameras(scene, run)[0]).items():
        lens = {"width": frame["w"], "height": frame["h"], "fx": frame["fl_x"], "fy": frame["fl_y"]}
        pose = conventions.opengl_to_opencv_camera(np.array(frame["transform_matrix"])).tolist()
        entry = {"name": f"train/{name}", "split": "train", "image": frame["file_path"], "parts": None}
        entry |= {"semantics": None, "camera_to_world": pose, "cx": frame["cx"], "cy": frame["cy"], **lens}
        entries[name] = entry
    return entries


def use_scene_cameras(scene, run) -> dict[str, dict]:
    """What the operator does, with the engine's `ingest`, which keeps pinholes as they are, left out."""
    entries = written(scene, run)
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    data = {**head, "views": list(entries.values()), "world_from_source": np.eye(4).tolist()}
    write_json(run.ingest_json, data)
    scene_cameras.adopt_cameras(run)
    return entries


@pytest.mark.parametrize(
    ("size", "aspect"),
    [((1920, 1080), (2.0, 1.0)), ((1080, 1920), (1.0, 1.5)), ((64, 64), (2.0, 1.0)), ((401, 300), (1.0, 1.0))],
    ids=str,
)
def test_a_camera_is_the_same_in_blender_and_in_the_engine(scene, run, tmp_path, size, aspect):
    """Sensor fit × frame method × shape of photograph × image pixels, in each shape of frame."""
    random, render = np.random.default_rng(7), scene.render

    def set_frame() -> None:
        render.resolution_x, render.resolution_y = size
        render.pixel_aspect_x, render.pixel_aspect_y = aspect

    set_frame()
    images = {}
    for (name, pixels), shape in itertools.product(PHOTOGRAPHS.items(), [(1.0, 1.0), (1.5, 1.0)]):
        images[name, shape] = photograph(tmp_path / f"{name}{shape[0]}.exr", *pixels)
        images[name, shape].display_aspect = shape
    items = []
    for index, (fit, method, (name, shape)) in enumerate(
        itertools.product(["AUTO", "HORIZONTAL", "VERTICAL"], ["FIT", "CROP", "STRETCH"], images)
    ):
        item = bpy.data.objects.new(f"{index:03d}", bpy.data.cameras.new("own"))
        scene.collection.objects.link(item)
        data, background = item.data, item.data.background_images.new()
        data.sensor_fit, data.lens = fit, random.uniform(15.0, 80.0)
        data.sensor_width, data.sensor_height = random.choice([1.2, 22.0, 36.0], 2)  # Blender takes 1 mm at least
        data.shift_x, data.shift_y = random.uniform(-0.2, 0.2, 2)
        background.image, background.frame_method = images[name, shape], method
        item.matrix_world = Matrix.LocRotScale(random.uniform(-1, 1, 3), Euler(random.uniform(-3, 3, 3)), None)
        items.append((item, PHOTOGRAPHS[name]))
    bpy.context.view_layer.update()
    first = written(scene, run)
    points, before = {}, {}
    for item, pixels in items:
        points[item.name] = points_before(first[item.name])[::6]
        before[item.name] = scene_projection(scene, item, points[item.name])
        in_photograph = lies_in_photograph(scene, item, before[item.name], pixels)
        assert np.abs(projections(first[item.name], points[item.name]) - in_photograph).max() < 0.01, item.name
    assert use_scene_cameras(scene, run) == first
    for item, pixels in items:
        # The artist's render resolution shows what it showed before ...
        after = scene_projection(scene, item, points[item.name])
        assert np.abs(after - before[item.name]).max() < 1e-5
        # ... and the photograph's shows what the engine sees.
        cameras.use_view(scene, item)
        assert (render.resolution_x, render.resolution_y) == pixels
        blender = scene_projection(scene, item, points[item.name]) * pixels
        assert np.abs(blender - projections(first[item.name], points[item.name])).max() < 0.01
        set_frame()
    assert use_scene_cameras(scene, run) == first
    cameras.use_view(scene, items[-1][0])
    assert use_scene_cameras(scene, run) == first
    assert export_capture(scene, run) == len(items)
    exported = {view["name"]: view for view in json.loads(run.capture_json.read_text())["views"]}
    assert all(exported[entry["name"]] == entry for entry in first.values())


def test_a_lens_that_is_changed_later_is_the_engines_too(scene, run, tmp_path):
    for name in "ab":
        own_camera(scene, tmp_path / f"{name}.exr", (40, 30)).data.background_images[0].frame_method = "FIT"
    first = use_scene_cameras(scene, run)
    item = scene.objects["a"]
    item.data.lens *= 1.5
    item.data.shift_x += 0.1
    export_capture(scene, run)
    views = {view["name"]: view for view in json.loads(run.capture_json.read_text())["views"]}
    assert views["train/b"] == first["b"] and views["train/a"]["fx"] == pytest.approx(1.5 * first["a"]["fx"])
    cameras.use_view(scene, item)
    bpy.context.view_layer.update()
    points = points_before(views["train/a"])
    assert np.abs(projections(views["train/a"], points) / (40, 30) - scene_projection(scene, item, points)).max() < 1e-5


def test_another_photograph_of_another_shape_is_seen_in_the_scenes_frame(scene, run, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 160, 90
    item = own_camera(scene, tmp_path / "a.exr", (40, 30))
    background = item.data.background_images[0]
    background.frame_method = "FIT"
    bpy.context.view_layer.update()
    first = use_scene_cameras(scene, run)["a"]
    background.image = photograph(tmp_path / "b.exr", 30, 40)
    second = use_scene_cameras(scene, run)["a"]
    points = points_before(second)
    places = scene_projection(scene, item, points)
    assert np.abs(lies_in_photograph(scene, item, places, (30, 40)) - projections(second, points)).max() < 1e-3
    assert second["fy"] / 40 == pytest.approx(first["fy"] / 30)


def test_a_lens_that_cannot_be_adapted_is_refused(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 160, 90
    item = own_camera(scene, tmp_path / "a.exr", (40, 30))
    item.data.keyframe_insert("lens", frame=1)
    assert scene_cameras.describe_camera(scene, item)["w"] == 40
    item.data.background_images[0].frame_method = "FIT"
    refusal = error_of(scene_cameras.describe_camera, scene, item)
    assert refusal.code == "camera-locked" and "40 x 30" in refusal.remedy
    scene.render.resolution_x, scene.render.resolution_y = 40, 30
    assert scene_cameras.describe_camera(scene, item)["fl_x"] == pytest.approx(40 * 50 / 36)


def test_unusable_cameras_are_refused(scene, run, tmp_path):

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
    item = own_camera(scene, tmp_path / "small.exr", (12, 6))
    item.data.background_images[0].image[LARGE_PHOTOGRAPH] = str(tmp_path / "large.exr")
    photograph(tmp_path / "large.exr", 48, 24)
    item[RESOLUTION], item[PIXEL_ASPECT] = (48, 24), (1.0, 1.0)
    frame = scene_cameras.describe_camera(scene, item)
    assert (frame["file_path"], frame["w"], frame["h"]) == (str(tmp_path / "large.exr"), 48, 24)
