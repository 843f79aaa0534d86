# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The color camera beside a depth camera is found from photographs of a slanting wall with fine patterns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.color_camera import find_color_camera, with_color_camera
from fipt_blender.core.capture.rig import Lens
from samples.rgbd_wall import FOCAL, SIZE, pose, write_frames


def test_focal_length_centre_and_place_of_the_color_camera_are_found(tmp_path: Path) -> None:
    rig = write_frames(tmp_path, 0.9, np.array([0.025, 0.004, 0.0]))
    found = with_color_camera(rig, 1.0)
    fx, fy, cx, cy = found.views[3].lens.parameters
    assert fx == pytest.approx(0.9 * 2 * FOCAL, rel=0.01) and fy == pytest.approx(fx)
    assert (cx, cy) == pytest.approx((SIZE[0] + 3.0, SIZE[1] - 4.0), abs=1.5)
    place = pose(3)[:3, :3].T @ (found.views[3].camera_to_world[:3, 3] - pose(3)[:3, 3])
    assert place == pytest.approx([0.025, 0.004, 0.0], abs=0.008)
    assert [note.code for note in found.notes] == ["color-camera"]
    moved = found.depths[3].photograph
    assert moved is not None and moved.lens == found.views[3].lens
    assert np.array_equal(found.depths[3].camera_to_world, pose(3))  # depth images keep theirs


def test_photographs_that_fit_keep_their_cameras(tmp_path: Path) -> None:
    rig = write_frames(tmp_path, 1.0, np.zeros(3))
    right = [replace(view, lens=Lens("PINHOLE", (280.0, 280.0, 163.0, 116.0))) for view in rig.views]
    depths = [replace(depth, photograph=view) for depth, view in zip(rig.depths, right, strict=True)]
    rig = replace(rig, views=tuple(right), depths=tuple(depths))
    found = with_color_camera(rig, 1.0)
    assert found is rig


def test_two_frames_tell_nothing(tmp_path: Path) -> None:
    rig = write_frames(tmp_path, 0.9, np.zeros(3))
    few = replace(rig, views=rig.views[:2], depths=rig.depths[:2])
    assert with_color_camera(few, 1.0) is few
    assert find_color_camera(few.depths, 1.0) is None
