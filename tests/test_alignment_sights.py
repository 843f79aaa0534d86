# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points picked through known cameras give back the similarity, and what does not decide it is said."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.alignment.sights import Sights, fit_sights
from fipt_blender.core.conventions import transform_points
from fipt_blender.core.run.errors import FiptError
from samples.camera_poses import drawn_similarity

CAMERAS = np.array([[1.0, 1.0, 1.2], [4.0, 1.2, 1.6], [3.5, 3.0, 1.4], [1.2, 2.8, 1.5]])


def picked(
    points: np.ndarray, cameras: list[list[int]], to_solve: np.ndarray, spread: float = 0.0, seed: int = 0
) -> Sights:
    """Rays through points, each from some cameras; no camera stands for a point that is known itself."""
    rng = np.random.default_rng(seed)
    rotation = to_solve[:3, :3] / np.cbrt(np.linalg.det(to_solve[:3, :3]))
    pairs, origins, directions = [], [], []
    for index, chosen in enumerate(cameras):
        for camera in chosen or [-1]:
            pairs.append(index)
            origins.append(points[index] if camera < 0 else CAMERAS[camera])
            ray = points[index] - CAMERAS[camera]
            ray = ray / np.linalg.norm(ray) + spread * rng.normal(size=3)
            directions.append(0.0 * ray if camera < 0 else rotation @ (ray / np.linalg.norm(ray)))
    return Sights(np.array(pairs), transform_points(to_solve, np.array(origins)), np.array(directions))


@pytest.mark.parametrize("scale", [0.0254, 1.0, 1000.0])
@pytest.mark.parametrize(
    "cameras",
    [
        [[0, 1], [1, 2], [2, 3]],  # three points, each in two photographs
        [[0], [1], [2], [3], [0]],  # five points, each in one
        [[], [], [0], [1]],  # two points of the solve, two in one photograph each
        [[], [], []],
    ],
)
def test_the_similarity_is_found(scale: float, cameras: list[list[int]]) -> None:
    rng = np.random.default_rng(len(cameras))
    points = rng.uniform([0, 0, 0], [5, 4, 2.6], (len(cameras), 3))
    to_solve, to_mesh = drawn_similarity(rng, 0.4), drawn_similarity(rng, scale)
    fit = fit_sights(picked(points, cameras, to_solve), transform_points(to_mesh, points))
    back = np.linalg.inv(to_mesh) @ fit.similarity @ to_solve
    np.testing.assert_allclose(back, np.eye(4), atol=1e-6)
    assert fit.error < 1e-6 * scale and fit.residuals.shape == (len(cameras),) and not fit.mirrored


def test_errors_of_a_pixel_cost_millimetres_and_the_wrong_pair_is_named() -> None:
    points = np.random.default_rng(1).uniform([0, 0, 0], [5, 4, 2.6], (6, 3))
    cameras = [[index % 4, (index + 1) % 4] for index in range(6)]
    pixel = 1.0 / 600.0
    fit = fit_sights(picked(points, cameras, np.eye(4), pixel), points)
    assert 0.001 < fit.error < 0.02
    assert np.linalg.norm(transform_points(fit.similarity, points) - points, axis=1).max() < 0.03
    sights = picked(points, cameras, np.eye(4), pixel)
    points[4] += (0.0, 0.3, 0.0)  # of the mesh alone
    assert int(fit_sights(sights, points).residuals.argmax()) == 4


def test_a_mirrored_mesh_is_said() -> None:
    points = np.random.default_rng(2).uniform([0, 0, 0], [5, 4, 2.6], (6, 3))
    cameras = [[index % 4, (index + 1) % 4] for index in range(6)]
    sights = picked(points, cameras, np.eye(4), 1e-3)
    assert fit_sights(sights, points * [1.0, -1.0, 1.0]).mirrored
    assert not fit_sights(sights, points).mirrored


@pytest.mark.parametrize(
    ("cameras", "text"),
    [([[0, 1], [1, 2]], "too few"), ([[0], [1], [2]], "too few"), ([[0], [0], [0], [0], [0]], "scale")],
)
def test_what_does_not_decide_the_placement_is_refused(cameras: list[list[int]], text: str) -> None:
    points = np.random.default_rng(3).uniform([0, 0, 0], [5, 4, 2.6], (len(cameras), 3))
    with pytest.raises(FiptError, match=text) as caught:
        fit_sights(picked(points, cameras, np.eye(4)), points)
    assert caught.value.code == "alignment-pairs" and caught.value.remedy.startswith("Pick")


def test_points_on_a_line_are_refused() -> None:
    points = np.outer(np.linspace(0.0, 1.0, 5), [4.0, 3.0, 2.0])
    with pytest.raises(FiptError, match="line"):
        fit_sights(picked(points, [[0, 1]] * 5, np.eye(4)), points)
