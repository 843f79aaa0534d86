# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that were taken beside their depth images get their own poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.color_camera import find_color_camera, with_color_camera
from fipt_blender.core.capture.photograph_poses import corrected_pose, find_motions, with_photograph_poses
from fipt_blender.core.capture.rig import Rig, RigView
from samples.rgbd_wall import FOCAL, FRAMES, SIZE, facing, pose, write_frames

SIZES = np.array([0.01, 0.01, 0.01, 0.015, 0.015, 0.015])  # of motions: radians and metres


def shaken(rig: Rig, motions: np.ndarray) -> Rig:
    """The rig with poses of photographs that are off by motions (V, 6)."""
    views = tuple(
        replace(view, camera_to_world=corrected_pose(view.camera_to_world, motion))
        for view, motion in zip(rig.views, motions, strict=True)
    )
    depths = tuple(replace(depth, photograph=view) for depth, view in zip(rig.depths, views, strict=True))
    return replace(rig, views=views, depths=depths)


def pixels_off(found: list[RigView], truth: Rig) -> float:
    """Median over the views of how far points two metres away (2000 mm) move in the photographs, pixels."""
    off = []
    points = np.array([[1000.0 * x, 1000.0 * y, 2000.0, 1.0] for x in (-0.6, 0.0, 0.6) for y in (-0.4, 0.0, 0.4)])
    for view, right in zip(found, truth.views, strict=True):
        local = points @ (np.linalg.inv(view.camera_to_world) @ right.camera_to_world).T
        focal = view.lens.parameters[0]
        moved = focal * (local[:, :2] / local[:, 2:3] - points[:, :2] / points[:, 2:3])
        off.append(np.sqrt((moved**2).sum(axis=1).mean()))
    return float(np.median(off))


def test_motions_are_found_in_any_unit(rig: Rig) -> None:
    """In a capture in millimetres; that of the next test is in metres."""
    larger = np.array([[1.0, 1.0, 1.0, 1000.0]] * 3 + [[1.0] * 4])
    views = tuple(replace(view, camera_to_world=view.camera_to_world * larger) for view in rig.views)
    depths = tuple(replace(depth, camera_to_world=depth.camera_to_world * larger) for depth in rig.depths)
    truth = replace(rig, views=views, depths=depths)
    motions = np.random.default_rng(1).normal(0.0, 1.0, (FRAMES, 6)) * SIZES
    motions -= motions.mean(axis=0)  # a motion of all is the color camera's place
    shaken_rig = shaken(truth, motions * ([1.0] * 3 + [1000.0] * 3))
    found, note = with_photograph_poses(shaken_rig, shaken_rig.views, 0.001)
    assert note is not None and note.code == "photograph-poses"
    assert pixels_off(list(shaken_rig.views), truth) > 1.8
    assert pixels_off(found, truth) < 0.5
    assert [view.name for view in found] == [view.name for view in rig.views]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """Photographs that fit the poses and cameras of their depth images."""
    return write_frames(tmp_path_factory.mktemp("frames"), 1.0, np.zeros(3), centre=(0.0, 0.0))


def test_right_poses_and_cameras_stay_and_two_photographs_tell_nothing(rig: Rig) -> None:
    assert with_color_camera(rig, 1.0) is rig
    assert find_motions(rig.depths[:2], 1.0) is None
    for count in (FRAMES, 2):
        views = rig.views[:count]
        found, note = with_photograph_poses(replace(rig, depths=rig.depths[:count]), views, 1.0)
        assert note is None and all(a is b for a, b in zip(found, views, strict=True))


def test_focal_length_centre_and_place_of_the_color_camera_are_found(tmp_path: Path) -> None:
    rig = write_frames(tmp_path, 0.9, np.array([0.025, 0.004, 0.0]))
    found = with_color_camera(rig, 1.0)
    fx, fy, cx, cy = found.views[3].lens.parameters
    assert fx == pytest.approx(0.9 * 2 * FOCAL, rel=0.01) and fy == pytest.approx(fx)
    assert (cx, cy) == pytest.approx((SIZE[0] + 3.0, SIZE[1] - 4.0), abs=1.5)
    place = pose(3)[:3, :3].T @ (found.views[3].camera_to_world[:3, 3] - pose(3)[:3, 3])
    assert place == pytest.approx([0.025, 0.004, 0.0], abs=0.01)
    assert [note.code for note in found.notes] == ["color-camera"]
    moved = found.depths[3].photograph
    assert moved is not None and moved.lens == found.views[3].lens
    assert np.array_equal(found.depths[3].camera_to_world, pose(3))  # depth images keep theirs


def test_what_a_flat_scene_leaves_open_stays_as_cameras_are_built(tmp_path: Path) -> None:
    """Before a wall, a camera beside another differs from one with another centre by errors of the poses."""
    truth = write_frames(tmp_path, 0.9, np.array([0.025, 0.0, 0.0]), (0.0, 0.0), facing)
    motions = np.random.default_rng(3).normal(0.0, 1.0, (FRAMES, 6)) * SIZES
    found = find_color_camera(shaken(truth, motions).depths, 1.0)
    assert found is not None and np.exp(found.log_focal) == pytest.approx(0.9, abs=0.02)
    assert found.unsettled == ("image centre", "place")
    assert max(abs(found.shift_x), abs(found.shift_y)) < 5.0 and max(abs(found.x), abs(found.y)) < 0.03
