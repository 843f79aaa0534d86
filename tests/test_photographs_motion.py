# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion between the exposures of a bracket: measured, undone, and what moved by itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from fipt_blender.core.photographs.merging import moved_regions
from fipt_blender.core.photographs.motion import Motion, after, measure, warped
from samples.photographs import smooth_radiance


@pytest.mark.parametrize("motion", [Motion(), Motion(0.01, -0.02, 0.01), Motion(0.08, 0.03, -0.02)])
def test_motion_is_measured_across_exposures(motion: Motion) -> None:
    height, width = 120, 160
    scene = 0.1 * smooth_radiance(9, 240, 320, 0.8)[..., 0]

    def shot(moved: Motion, exposure: float) -> np.ndarray:
        y, x = np.mgrid[:height, :width] + 0.5
        back = Motion(0.0, 0.0, -moved.angle)
        points = np.stack([x.ravel(), y.ravel()], -1) - width * np.array([moved.x, moved.y])
        places = back.apply(points, width, height) + [width / 2 - 0.5, height / 2 - 0.5]
        values = ndimage.map_coordinates(scene, [places[:, 1], places[:, 0]], order=3).reshape(height, width)
        return np.where(values * exposure < 1.0, values * exposure, np.nan)

    found = measure(shot(Motion(), 1.0), shot(motion, 4.0))
    rest = Motion(found.x - motion.x, found.y - motion.y, found.angle - motion.angle)
    assert rest.corner_shift(width, height) < 0.1 and found.similarity > 0.95


def test_a_bare_wall_does_not_move() -> None:
    rng = np.random.default_rng(4)
    walls = [np.full((120, 160), 0.3) + rng.normal(0.0, 0.01, (120, 160)) for _ in range(2)]
    assert measure(*walls) == Motion()


def test_motions_follow_one_another() -> None:
    first, second = Motion(0.1, -0.05, 0.3), Motion(-0.02, 0.04, -0.1)
    points = np.random.default_rng(0).uniform(0.0, 100.0, (5, 2))
    both = second.apply(first.apply(points, 120, 80), 120, 80)
    np.testing.assert_allclose(after(first, second).apply(points, 120, 80), both)


def test_warping_shifts_rows_and_marks_what_is_outside() -> None:
    values = np.arange(20.0)[:, None, None].repeat(10, 1)
    moved = warped(values, Motion(y=0.1), 0, 20)  # two rows of twenty
    np.testing.assert_allclose(moved[:18, :, 0], values[2:, :, 0])
    assert np.isnan(moved[18:]).all()


def test_what_moves_is_taken_from_one_exposure() -> None:
    still = np.ones((20, 30))
    first, second, third = still.copy(), still.copy(), still.copy()
    first[5:10, 5:10], second[5:10, 12:17] = 3.0, 3.0
    third[:, 20:] = np.nan
    choice = moved_regions([first, second, third], [np.full((20, 30), 0.01)] * 3)
    assert (choice[6:9, 6:9] == 2).all() and (choice[12:] == -1).all() and (choice[:, 24:] == -1).all()
    assert len(set(choice[5:10, 12:17].ravel())) == 1  # one region, one exposure
    noisy = [still + np.random.default_rng(i).normal(0.0, 0.03, still.shape) for i in range(3)]
    assert (moved_regions(noisy, [np.full((20, 30), 0.03)] * 3) == -1).all()
