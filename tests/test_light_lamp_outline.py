# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines of lamps on a scan: a photographed panel keeps its area, whatever its mask says."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fipt_blender.core.capture.views import View
from fipt_blender.core.light.lamp_outline import outlined
from fipt_blender.core.scene.pixels import PixelStore, open_pixels
from samples.scans import scanned_box

ROOM, SIDE = scanned_box(cells=100, noise=0.002)
CEILING, HEIGHT = 1, 3.0
SIZE, FOCAL, CAMERAS = 48, 30.0, [[-0.2, 0.1, 1.0], [0.3, 0.2, 0.8], [0.0, -0.3, 1.2]]


def looking_up(folder: Path, low: float, high: float, radiance: float) -> PixelStore:
    """Photographs of the ceiling (radiance 1), with a lamp in the square from low to high of x and y."""
    assert ROOM.scan is not None
    # OpenCV axes: the camera looks along world Z.
    poses = [np.vstack([np.column_stack([np.eye(3), place]), [0.0, 0.0, 0.0, 1.0]]) for place in CAMERAS]
    middle = SIZE / 2
    views = [
        View(f"train/{i}", "train", Path(), SIZE, SIZE, FOCAL, FOCAL, middle, middle, pose)
        for i, pose in enumerate(poses)
    ]
    pixels = open_pixels(folder / "pixels", views, create=True)
    ceiling = np.flatnonzero(SIDE == CEILING)
    tree = cKDTree(ROOM.scan.centers[ceiling])
    fine = (np.arange(SIZE * 8) + 0.5) / 8
    for index, pose in enumerate(poses):
        depth = HEIGHT - pose[2, 3]
        x, y = (depth * (fine - middle) / FOCAL + pose[axis, 3] for axis in (0, 1))
        on_lamp = np.outer((y > low) & (y < high), (x > low) & (x < high))
        share = on_lamp.reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3)).ravel()
        rows = pixels.rows(index)
        pixels.radiance[rows] = (1.0 + (radiance - 1.0) * share)[:, None]
        centers = (np.arange(SIZE) + 0.5 - middle) / FOCAL * depth
        points = np.array([[u + pose[0, 3], v + pose[1, 3], HEIGHT] for v in centers for u in centers])
        pixels.position[rows] = points
        inside = (np.abs(points[:, :2]) < 2.0).all(axis=1)
        pixels.triangle[rows] = np.where(inside, ceiling[tree.query(points)[1]], -1)
    return pixels


def square(low: float, high: float) -> np.ndarray:
    """(T,) bool, triangles of the ceiling in a square of x and y."""
    assert ROOM.scan is not None
    centers = ROOM.scan.centers[:, :2]
    return np.asarray((SIDE == CEILING) & (centers > low).all(axis=1) & (centers < high).all(axis=1))


@pytest.mark.parametrize("marked", [(-0.58, 0.56), (-0.44, 0.46), (-0.45, 0.58)])
def test_a_lamp_has_the_area_that_is_photographed(tmp_path: Path, marked: tuple[float, float]) -> None:
    pixels = looking_up(tmp_path, -0.5, 0.5, 200.0)
    before = square(*marked)
    likely = np.where(before, 0.9, 0.0).astype(np.float32)
    found = outlined(ROOM.scan, pixels, likely, 0.06)
    after = found > 0.5
    assert np.allclose(found[after], 0.9) and np.allclose(found[before & ~after], 0.1)
    assert abs(ROOM.areas[before].sum() - 1.0) > 0.04
    assert abs(ROOM.areas[after].sum() - 1.0) < 0.03


def test_what_no_photograph_shows_stays_as_it_is(tmp_path: Path) -> None:
    pixels = looking_up(tmp_path, -0.5, 0.5, 200.0)
    pixels.triangle[:] = -1
    before = square(-0.58, 0.58).astype(np.float32)
    assert np.array_equal(outlined(ROOM.scan, pixels, before, 0.06), before)
    assert not outlined(ROOM.scan, pixels, np.zeros_like(before), 0.06).any()
