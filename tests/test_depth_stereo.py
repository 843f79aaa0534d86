# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Range images and a mesh of photographs alone, of a box whose distances are known."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.photograph_mesh import Photograph, photograph_mesh
from fipt_blender.core.capture.rig import Pinhole
from fipt_blender.core.depth.hull import Hull
from fipt_blender.core.depth.stereo import Shot, range_images
from fipt_blender.core.run.errors import FiptError

HALF = 2.0  # metres, of the box's edges
WIDTH, HEIGHT, FOCAL = 72, 54, 40.0
# What a camera solve finds on the walls.
POINTS = HALF * np.sign(np.eye(3)[np.arange(200) % 3]) + np.random.default_rng(1).uniform(-1.8, 1.8, (200, 3)) * (
    1.0 - np.eye(3)[np.arange(200) % 3]
)


def distance(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(...) multiples of directions (..., 3) from a point inside to the box."""
    with np.errstate(divide="ignore"):
        return np.min((np.sign(direction) * HALF - origin) / direction, axis=-1)


def pattern(points: np.ndarray) -> np.ndarray:
    """(...) gray of points (..., 3): waves of 0.4 m and more."""
    waves = np.random.default_rng(3).normal(0.0, 6.0, (12, 3))
    return np.asarray(0.5 + 0.12 * np.sin(points @ waves.T + np.arange(12)).sum(axis=-1)).clip(0.02, 1.0)


def shots() -> list[Shot]:
    """Of eight cameras that look along X."""
    found = []
    for y in (-0.45, -0.15, 0.15, 0.45):
        for z in (-0.2, 0.2):
            pose = np.eye(4)
            pose[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
            pose[:3, 3] = -1.0, y, z
            shot = Shot(np.zeros((HEIGHT, WIDTH), np.float32), FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)
            rays = np.moveaxis(np.tensordot(pose[:3, :3], shot.rays, 1), 0, -1)
            seen = pattern(pose[:3, 3] + rays * distance(pose[:3, 3], rays)[..., None])
            found.append(Shot(seen.astype(np.float32), *(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), pose))
    return found


def test_range_images_of_photographs_have_the_true_distances() -> None:
    given = shots()
    images = range_images(given, [(0.8, 5.0)] * len(given))
    errors, known = [], 0.0
    for shot, image in zip(given, images, strict=True):
        rays = np.moveaxis(np.tensordot(shot.camera_to_world[:3, :3], shot.rays, 1), 0, -1)
        true = distance(shot.camera_to_world[:3, 3], rays)
        seen = image.depth > 0.0
        known += seen.mean() / len(given)
        errors.append(np.abs(image.depth[seen] / true[seen] - 1.0))
    assert known > 0.4 and np.median(np.concatenate(errors)) < 0.02


def test_a_hull_holds_the_room_and_not_what_is_far_outside() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-HALF, HALF, (20_000, 3))
    side = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), side] = HALF * rng.choice([-1.0, 1.0], len(points))
    points[:20] *= 30.0
    hull = Hull.around(points, np.eye(3), np.zeros((1, 3)))
    rays = np.concatenate([np.eye(3), -np.eye(3)]).T
    np.testing.assert_allclose(hull.depth(np.zeros(3), rays), HALF, rtol=0.05)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Photograph]:
    folder, found = tmp_path_factory.mktemp("photographs"), []
    camera = Pinhole(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    for index, shot in enumerate(shots()):
        path = folder / f"{index}.exr"
        write_exr(path, np.repeat(shot.gray[..., None], 3, axis=2))
        found.append(Photograph(path, "", camera, shot.camera_to_world))
    return found


def test_a_mesh_is_made_of_photographs_and_their_hull(photographs: list[Photograph]) -> None:
    mesh, note = photograph_mesh(photographs, POINTS, lambda share: None)
    away = np.abs(np.abs(mesh.vertices).max(axis=1) - HALF)
    assert len(mesh.triangles) > 500 and np.median(away) < 0.1
    assert note.code == "mesh-from-photographs" and "alone" in note.text
    one = photographs[0]
    direction = one.camera_to_world[:3, 2]
    behind = (mesh.vertices - one.camera_to_world[:3, 3]) @ direction > 0.5
    local = (mesh.vertices[behind] - one.camera_to_world[:3, 3]) @ one.camera_to_world[:3, :3]
    column = FOCAL * local[:, 0] / local[:, 2] + WIDTH / 2
    assert column.min() < 0.2 * WIDTH and column.max() > 0.8 * WIDTH, "it covers what the photographs show"


def test_photographs_of_one_place_make_no_mesh(photographs: list[Photograph]) -> None:
    with pytest.raises(FiptError, match="several sides"):
        photograph_mesh(photographs[:1], POINTS, lambda share: None)
