"""Conversions are inverses of each other and agree with Blender."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core import conventions
from fipt_blender.core.capture.views import View
from samples.camera_poses import random_rotation

# width, height, fx, fy, cx, cy: fx != fy, off-centre, portrait
INTRINSICS = [
    (640, 320, 500.0, 500.0, 320.0, 160.0),
    (640, 320, 480.0, 530.0, 300.5, 171.25),
    (320, 640, 530.0, 480.0, 150.0, 333.0),
    (333, 257, 91.5, 260.0, 12.0, 250.0),
]


def random_pose(rng: np.random.Generator) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = random_rotation(rng)
    pose[:3, 3] = rng.normal(size=3) * 5.0
    return pose


def make_view(rng: np.random.Generator, values: tuple) -> View:
    width, height, fx, fy, cx, cy = values
    return View("v", "train", Path("v.exr"), width, height, fx, fy, cx, cy, random_pose(rng))


@pytest.mark.parametrize(
    ("there", "back"),
    [
        (conventions.opencv_to_blender_camera, conventions.blender_to_opencv_camera),
        (conventions.fipt_to_opencv_camera, conventions.fipt_to_opencv_camera),
    ],
)
def test_camera_axes_round_trip(there, back):
    rng = np.random.default_rng(1)
    poses = np.stack([random_pose(rng) for _ in range(8)])
    np.testing.assert_allclose(back(there(poses)), poses, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(there(poses)[:, :3, :3]), 1.0)


def test_camera_axes_point_where_their_convention_says():
    pose = np.eye(4)  # looks along +Z, X right, Y down
    blender = conventions.opencv_to_blender_camera(pose)
    np.testing.assert_array_equal(-blender[:3, 2], [0, 0, 1])  # a Blender camera looks along its -Z
    np.testing.assert_array_equal(blender[:3, 1], [0, -1, 0])  # its Y is up
    np.testing.assert_array_equal(conventions.fipt_to_opencv_camera(pose)[:3, 0], [-1, 0, 0])  # X left
    np.testing.assert_array_equal(conventions.fipt_to_opencv_camera(pose)[:3, 1], [0, -1, 0])  # Y up
    np.testing.assert_array_equal(conventions.fipt_to_opencv_camera(pose)[:3, 2], [0, 0, 1])  # Z forward


@pytest.mark.parametrize("axis", conventions.UP_AXES)
def test_up_axis_becomes_z_and_scale_metres(axis):
    similarity = conventions.world_from_source(axis, 0.01)
    up = np.zeros(3)
    up["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    np.testing.assert_allclose(conventions.transform_points(similarity, up * 100.0), [0, 0, 1], atol=1e-12)
    scale, rotation, translation = conventions.split_similarity(similarity)
    assert scale == pytest.approx(0.01, abs=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_array_equal(translation, 0.0)


def test_y_up_is_turned_as_blenders_importers_do():
    moved = conventions.transform_points(conventions.world_from_source("y"), [[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(moved, [[1.0, -3.0, 2.0]])


@pytest.mark.parametrize(("axis", "scale"), [("w", 1.0), ("z", 0.0), ("z", -1.0), ("z", np.nan)])
def test_impossible_world_is_refused(axis, scale):
    with pytest.raises(ValueError):
        conventions.world_from_source(axis, scale)


def test_similarity_moves_cameras_points_and_normals_together():
    rng = np.random.default_rng(2)
    similarity = np.eye(4)
    similarity[:3, :3] = 0.3 * random_rotation(rng)
    similarity[:3, 3] = [1.0, -2.0, 0.5]
    view = make_view(rng, INTRINSICS[1])
    _, directions = conventions.rays_at(view, rng.uniform(0, 300, (20, 2)))
    points = view.camera_to_world[:3, 3] + directions * rng.uniform(1, 5, (20, 1))
    moved_pose = conventions.transform_poses(similarity, view.camera_to_world)
    moved = View("m", "train", Path(), *INTRINSICS[1], camera_to_world=moved_pose)
    before, depth = conventions.project(points, view)
    after, moved_depth = conventions.project(conventions.transform_points(similarity, points), moved)
    np.testing.assert_allclose(after, before, atol=1e-6)
    np.testing.assert_allclose(moved_depth, 0.3 * depth, rtol=1e-9)
    np.testing.assert_allclose(moved_pose[:3, :3] @ moved_pose[:3, :3].T, np.eye(3), atol=1e-12)
    back = conventions.transform_poses(np.linalg.inv(similarity), moved_pose)
    np.testing.assert_allclose(back, view.camera_to_world, atol=1e-6)


@pytest.mark.parametrize("values", INTRINSICS)
@pytest.mark.parametrize("z_depth", [False, True])
def test_projection_of_rays_gives_pixel_centres(values, z_depth):
    rng = np.random.default_rng(3)
    view = make_view(rng, values)
    origins, directions = conventions.pixel_rays(view, z_depth)
    assert origins.dtype == directions.dtype == np.float32
    assert origins.shape == directions.shape == (view.width * view.height, 3)
    distance = rng.uniform(0.5, 8.0, (len(origins), 1))
    # Relative to the ray's float32 origin: its rounding is not an error of the projection.
    exact = View("e", "train", Path(), *values, camera_to_world=view.camera_to_world.copy())
    exact.camera_to_world[:3, 3] = origins[0]
    pixels, depth = conventions.project(origins.astype(float) + directions.astype(float) * distance, exact)
    expected = np.stack(np.meshgrid(np.arange(view.width), np.arange(view.height)), -1).reshape(-1, 2) + 0.5
    np.testing.assert_allclose(pixels, expected, atol=1e-4)
    if z_depth:
        np.testing.assert_allclose(depth, distance[:, 0], rtol=1e-5)
    else:
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)


def test_points_behind_the_camera_have_no_pixel():
    view = View("v", "train", Path(), *INTRINSICS[0], camera_to_world=np.eye(4))
    pixels, depth = conventions.project([[0, 0, -1], [0, 0, 0], [0, 0, 1]], view)
    assert np.isnan(pixels[:2]).all() and np.allclose(pixels[2], [320, 160])
    np.testing.assert_array_equal(depth, [-1, 0, 1])


@pytest.mark.parametrize("values", INTRINSICS)
def test_blender_camera_round_trip(values):
    width, height, *intrinsics = values
    camera = conventions.intrinsics_to_blender(width, height, *intrinsics)
    assert min(camera.pixel_aspect_x, camera.pixel_aspect_y) >= 1.0  # Blender's limit
    np.testing.assert_allclose(conventions.blender_to_intrinsics(width, height, camera), intrinsics, rtol=1e-9)


def test_equirect_round_trip():
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(1000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    uv = conventions.direction_to_equirect(directions)
    assert uv.min() >= 0.0 and uv.max() <= 1.0
    np.testing.assert_allclose(conventions.equirect_to_direction(uv), directions, atol=1e-6)
    np.testing.assert_allclose(conventions.direction_to_equirect(directions * 7.0), uv, atol=1e-12)


def test_equirect_image_has_the_sky_on_top():
    directions = conventions.equirect_pixel_directions(8, 4)
    assert directions.shape == (4, 8, 3)
    assert (directions[0, :, 2] > 0.9).all() and (directions[-1, :, 2] < -0.9).all()
    assert directions[1, 3, 0] > 0 and directions[1, 4, 0] > 0  # the middle looks along +X
    assert directions[1, 5, 1] < 0 < directions[1, 2, 1]
