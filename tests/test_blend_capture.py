# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures into the scene and back: exact cameras, also under a moved alignment; ticks, splits, own ones."""

from __future__ import annotations

import json
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.blend import capture_import, scene_cameras
from fipt_blender.blend.capture_export import camera_pose, export_capture, find_mask
from fipt_blender.blend.slices import run_through
from fipt_blender.core import conventions
from fipt_blender.core.job.errors import FiptError
from fipt_blender.core.job.runfolder import RunFolder, read_json, write_json
from fipt_blender.core.job.settings import make_settings

INTRINSICS = {
    "plain": dict(width=192, height=108, fx=150.0, fy=150.0, cx=96.0, cy=54.0),
    "off-centre": dict(width=192, height=108, fx=150.0, fy=150.0, cx=80.3, cy=61.7),
    "fx > fy": dict(width=192, height=108, fx=180.0, fy=140.0, cx=90.0, cy=50.0),
    "fx < fy": dict(width=192, height=108, fx=140.0, fy=180.0, cx=101.0, cy=57.0),
    "portrait": dict(width=108, height=192, fx=150.0, fy=155.0, cx=50.0, cy=101.0),
}
ALIGNED = Matrix.LocRotScale((1.5, -2.0, 0.3), Euler((0.2, -0.1, 1.1)), (0.4,) * 3)


class Pinhole:
    """An entry of capture.json as `conventions` wants it."""

    def __init__(self, entry: dict) -> None:
        self.__dict__.update(entry)
        self.camera_to_world = np.array(entry["camera_to_world"])


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def run(tmp_path, scene):
    folder = RunFolder(tmp_path / "run")
    folder.create(make_settings())
    random = np.random.default_rng(3)
    views = []
    for name, intrinsics in INTRINSICS.items():
        rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
        pose[:3, 3] = random.uniform(-2, 2, 3)
        views.append(
            {"name": f"train/{name}", "split": "train", "image": f"images/{name}.exr", "parts": None,
             "semantics": None, "camera_to_world": pose.tolist(), **intrinsics}
        )  # fmt: skip
    views[0]["split"] = "held_back"
    mesh = tmp_path / "scene.obj"
    mesh.write_text("o room\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    world = conventions.world_from_source("y", 2.0)
    data = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": str(mesh), "views": views}
    write_json(folder.ingest_json, {**data, "world_from_source": world.tolist()})
    scene.fipt.run_folder = str(folder.root)
    return folder


def bring_in(run: RunFolder, path: str = "somewhere") -> list:
    return run_through(capture_import.import_capture(run, path))


def entries(run: RunFolder) -> dict[str, dict]:
    return {entry["name"]: entry for entry in read_json(run.capture_json)["views"]}


def projections(entry: dict, points: np.ndarray) -> np.ndarray:
    pixels, depth = conventions.project(points, Pinhole(entry))
    assert (depth > 0).all()
    return pixels


def points_before(entry: dict) -> np.ndarray:
    """Points all over the image of a view, at depths of 1 to 3 m."""
    random = np.random.default_rng(5)
    pixels = random.uniform(0, 1, (60, 2)) * [entry["width"], entry["height"]]
    origins, directions = conventions.rays_at(Pinhole(entry), pixels)
    return origins + directions * random.uniform(1, 3, (60, 1))


def test_unmoved_cameras_keep_their_poses_to_the_bit(run, scene):
    bring_in(run)
    assert export_capture(scene, run) == 5
    before = {entry["name"]: entry for entry in read_json(run.ingest_json)["views"]}
    assert entries(run) == before
    bpy.context.view_layer.update()
    time = run.capture_json.stat().st_mtime_ns
    export_capture(scene, run)
    assert run.capture_json.stat().st_mtime_ns == time  # nothing changed, so that a run can resume


@pytest.mark.parametrize("evaluated", [True, False])
def test_round_trip_under_a_moved_turned_and_scaled_alignment(run, scene, evaluated):
    """What a view showed at a pixel it shows there still, after the room and its cameras went elsewhere."""
    bring_in(run)
    settings = scene.fipt.capture
    settings.alignment.matrix_basis = ALIGNED
    if evaluated:
        bpy.context.view_layer.update()
    else:  # Blender evaluates nothing in hidden collections
        scene.view_layers[0].layer_collection.children["FIPT Cameras"].hide_viewport = True
    export_capture(scene, run)
    move = np.array(ALIGNED, np.float64)
    for before in read_json(run.ingest_json)["views"]:
        after = entries(run)[before["name"]]
        points = points_before(before)
        expected = projections(before, points)
        found = projections(after, points @ move[:3, :3].T + move[:3, 3])
        assert np.abs(found - expected).max() < 1e-4
        turn = np.array(after["camera_to_world"])[:3, :3]
        assert np.abs(turn.T @ turn - np.eye(3)).max() < 1e-12


def test_the_mesh_follows_the_alignment_and_the_capture_s_axes(run, scene):
    bring_in(run)
    (room,) = scene.fipt.capture.room_objects(scene)
    scene.fipt.capture.alignment.matrix_basis = ALIGNED
    bpy.context.view_layer.update()
    world = np.array([room.matrix_world @ vertex.co for vertex in room.data.vertices])
    source = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    expected = conventions.transform_points(
        np.array(ALIGNED) @ conventions.world_from_source("y", 2.0), source
    )
    assert np.abs(np.sort(world, axis=0) - np.sort(expected, axis=0)).max() < 1e-5


def test_a_camera_moved_by_hand_counts(run, scene):
    bring_in(run)
    camera = scene.fipt.capture.views[1].camera_object()
    camera.location.x += 0.25
    export_capture(scene, run)
    before = np.array(read_json(run.ingest_json)["views"][1]["camera_to_world"])
    after = np.array(entries(run)["train/off-centre"]["camera_to_world"])
    assert (after - before)[0, 3] == pytest.approx(0.25, abs=1e-6)
    assert camera.name in scene.objects and np.allclose(after[:3, :3], before[:3, :3], atol=1e-6)


@pytest.mark.parametrize("scale", [(1, 1, 2), (-1, 1, 1), (0, 0, 0)])
def test_an_uneven_alignment_is_refused(run, scene, scale):
    bring_in(run)
    scene.fipt.capture.alignment.scale = scale
    with pytest.raises(FiptError) as error:
        export_capture(scene, run)
    assert error.value.code == "alignment-uneven"
    assert not run.capture_json.exists()


def test_ticks_splits_and_deleted_cameras(run, scene):
    bring_in(run)
    settings = scene.fipt.capture
    assert (settings.train_count, settings.held_back_count) == (4, 1)
    settings.views["train/portrait"].enabled = False
    settings.views["train/plain"].split = "train"
    settings.views["train/fx > fy"].split = "held_back"
    assert (settings.train_count, settings.held_back_count) == (3, 1)
    bpy.data.objects.remove(settings.views["train/fx < fy"].camera_object())
    assert export_capture(scene, run) == 3
    assert {name: entry["split"] for name, entry in entries(run).items()} == {
        "train/plain": "train",
        "train/off-centre": "train",
        "train/fx > fy": "held_back",
    }
    settings.views["train/portrait"].enabled = True  # nothing was lost by leaving it out
    assert export_capture(scene, run) == 4
    settings.views["train/plain"].enabled = settings.views["train/off-centre"].enabled = False
    before = run.capture_json.read_bytes()
    with pytest.raises(FiptError) as error:
        export_capture(scene, run)
    assert error.value.code == "views-few" and run.capture_json.read_bytes() == before


def test_renamed_cameras_are_found(run, scene):
    bring_in(run)
    scene.fipt.capture.views[0].camera_object().name = "Hero"
    assert scene.fipt.capture.views[0].camera_object().name == "Hero"
    assert export_capture(scene, run) == 5


def test_importing_again_keeps_ticks_and_alignment_and_adds_nothing(run, scene):
    bring_in(run)
    settings = scene.fipt.capture
    settings.views[2].enabled = False
    settings.alignment.location.x = 3.0
    count = len(bpy.data.objects)
    bring_in(run)
    assert len(bpy.data.objects) == count and not settings.views[2].enabled
    assert settings.alignment.location.x == 3.0
    export_capture(scene, run)
    moved = np.array(entries(run)["train/plain"]["camera_to_world"])[0, 3]
    assert moved == pytest.approx(
        read_json(run.ingest_json)["views"][0]["camera_to_world"][0][3] + 3.0, abs=1e-5
    )


def test_another_capture_takes_its_own_cameras_and_sets_the_old_mesh_aside(run, scene, tmp_path):
    bring_in(run)
    (old,) = scene.fipt.capture.room_objects(scene)
    own = bpy.data.objects.new("Artist's", bpy.data.cameras.new("Artist's"))
    scene.collection.objects.link(own)
    data = read_json(run.ingest_json)
    other = tmp_path / "other.obj"
    other.write_text(Path(data["mesh"]).read_text())
    data["views"] = [{**view, "name": f"b/{index}"} for index, view in enumerate(data["views"][:3])]
    write_json(run.ingest_json, {**data, "mesh": str(other)})
    bring_in(run, "elsewhere")
    cameras = sorted(item.name for item in scene.objects if item.type == "CAMERA")
    assert cameras == ["Artist's", "b/0", "b/1", "b/2"] and len(scene.fipt.capture.views) == 3
    (new,) = scene.fipt.capture.room_objects(scene)
    assert new != old and [each.name for each in old.users_collection] == ["FIPT Earlier Rooms"]
    assert old.users_collection[0].hide_viewport and old.users_collection[0].hide_render


def test_chosen_objects_stay_the_room_untouched(run, scene):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    before = (cube.parent, cube.matrix_basis.copy(), [each.name for each in cube.users_collection])
    capture_import.set_room(scene, [cube])
    warnings = bring_in(run)
    assert [message["code"] for message in warnings] == ["mesh-kept"]
    assert scene.fipt.capture.room_objects(scene) == [cube]
    assert (cube.parent, cube.matrix_basis) == before[:2]
    assert {each.name for each in cube.users_collection} == {*before[2], "FIPT Room"}
    plane = bpy.data.objects.new("plane", cube.data)
    scene.collection.objects.link(plane)
    capture_import.set_room(scene, [plane])
    assert scene.fipt.capture.room_objects(scene) == [plane]
    assert cube.name in scene.objects  # it was only taken from the collection


def test_a_room_without_mesh_says_so(run, scene):
    write_json(run.ingest_json, {**read_json(run.ingest_json), "mesh": None})
    assert [message["code"] for message in bring_in(run)] == ["mesh-missing"]
    assert len(scene.fipt.capture.views) == 5


def test_masks_of_a_folder(run, scene, tmp_path):
    bring_in(run)
    parts, folder = scene.fipt.parts, tmp_path / "masks"
    parts.source = "folder"
    for problem in ("", str(folder)):
        parts.folder = problem
        with pytest.raises(FiptError) as error:
            export_capture(scene, run)
        assert error.value.code == "parts-folder"
    (folder / "train").mkdir(parents=True)
    with pytest.raises(FiptError) as error:
        export_capture(scene, run)
    assert "plain.png" in error.value.remedy
    (folder / "train" / "plain.png").touch()
    (folder / "off-centre.exr").touch()
    assert find_mask(folder, "train/portrait", "portrait") is None
    export_capture(scene, run)
    found = {name: entry["parts"] for name, entry in entries(run).items()}
    assert found["train/plain"] == str(folder / "train" / "plain.png")
    assert found["train/off-centre"] == str(folder / "off-centre.exr") and found["train/portrait"] is None
    assert parts.engine_source == "masks"
    parts.source = "auto"
    export_capture(scene, run)
    assert not any(entry["parts"] for entry in entries(run).values())


def test_runs_of_the_command_line_keep_all_their_views(run, scene):
    """They have no ingest.json: capture.json is the source until something is left out."""
    run.ingest_json.rename(run.capture_json)
    run_through(iter_views(run, scene))
    scene.fipt.capture.views[1].enabled = False
    assert export_capture(scene, run) == 4
    scene.fipt.capture.views[1].enabled = True
    assert export_capture(scene, run) == 5
    run.ingest_json.unlink()
    run.capture_json.unlink()
    with pytest.raises(FiptError) as error:
        export_capture(scene, run)
    assert error.value.code == "capture-missing"


def iter_views(run, scene):
    from fipt_blender.blend import cameras

    cameras.add_cameras(run, scene, photographs=False)
    yield
    capture_import.fill_views(scene, run)


# --- the scene's own cameras ------------------------------------------------------------------------------


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
def test_own_cameras_project_as_blender_does(scene, tmp_path, size, aspect, lens):
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


def test_a_photograph_of_another_shape_than_the_frame(scene, tmp_path):
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


def test_own_cameras_that_cannot_be_used_are_named(scene, tmp_path):
    run = RunFolder(tmp_path / "run")

    def code() -> str:
        with pytest.raises(FiptError) as error:
            scene_cameras.write_scene_cameras(scene, run)
        assert error.value.remedy
        return error.value.code

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
    background.image = photograph(tmp_path / "ldr.png", 32, 16, "PNG")
    assert code() == "image-ldr"
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
