"""Known similarities between a solve and a mesh are found again, from pairs, sparse points and sights."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.alignment.pairs import fit_pairs
from fipt_blender.core.alignment.registration import refine
from fipt_blender.core.alignment.sights import Sights, fit_sights
from fipt_blender.core.alignment.surface import closest_points, sample_surface, unit_normals
from fipt_blender.core.capture.formats.registry import read_points
from fipt_blender.core.conventions import transform_points
from samples import metashape_writers, rig_writers
from samples.camera_poses import drawn_similarity
from samples.refusals import error_of
from samples.rgbd_frames import BOX_ROOM
from samples.scans import grid_triangles
from samples.small_rooms import block, make_room


def mesh_of(*blocks: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of blocks."""
    room = make_room([quad for corners in blocks for quad in block(*corners)])
    return room.vertices.astype(np.float64), room.triangles


def furnished_room() -> tuple[np.ndarray, np.ndarray]:
    """Boxes stand differently along each wall; no turn maps it to itself."""
    return mesh_of(*BOX_ROOM)


def sparse_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points on what can be seen, off by 3 mm, one in twenty far off; nothing on the ceiling."""
    surface = sample_surface(*furnished_room(), rng, 4000)
    seen = surface.points[surface.points[:, 2] < 2.5]
    points = seen[rng.permutation(len(seen))[:count]] + 0.003 * rng.normal(size=(count, 3))
    points[: count // 20] += 0.5 * rng.normal(size=(count // 20, 3))
    return points


# ----------------------------------------------------------------------------------------------------- pairs


@pytest.mark.parametrize("scale, count", [(0.0254, 3), (1000.0, 8)])
def test_pairs_give_the_similarity(scale: float, count: int) -> None:
    rng = np.random.default_rng(count)
    matrix = drawn_similarity(rng, scale)
    source = rng.normal(size=(count, 3))
    fit = fit_pairs(source, transform_points(matrix, source))
    np.testing.assert_allclose(fit.similarity, matrix, atol=1e-9 * scale)
    assert fit.error < 1e-9 * scale and not fit.mirrored and fit.residuals.shape == (count,)


def test_mirrored_mesh_is_said() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(6, 3))
    noise = 0.01 * rng.normal(size=(6, 3))
    assert fit_pairs(source, source * [1.0, -1.0, 1.0] + noise).mirrored
    assert not fit_pairs(source, source + noise).mirrored
    flat = source * [1.0, 1.0, 0.0]
    assert not fit_pairs(flat, flat * [1.0, -1.0, 1.0]).mirrored  # fits by a turn as well


@pytest.mark.parametrize(
    ("source", "text"),
    [
        (np.eye(3)[:2], "2 pairs"),
        (np.outer(np.arange(4.0), [1.0, 2.0, 3.0]), "one line"),
        (np.zeros((4, 3)), "one line"),
        (np.full((3, 3), np.nan), "finite"),
    ],
)
def test_pairs_that_decide_nothing(source: np.ndarray, text: str) -> None:
    target = np.random.default_rng(2).normal(size=source.shape)
    for pair in ((source, target), (target, source)):
        error = error_of(fit_pairs, *pair)
        assert error.code == "alignment-pairs" and text in error.text


# --------------------------------------------------------------------------------------------------- surface


def test_closest_points_of_triangles_by_brute_force() -> None:
    rng = np.random.default_rng(3)
    corners, positions = rng.normal(size=(40, 3, 3)), 1.5 * rng.normal(size=(40, 3))
    share = np.stack(np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201)), axis=-1).reshape(-1, 2)
    share = share[share.sum(axis=1) <= 1.0 + 1e-9]
    weights = np.concatenate([1.0 - share.sum(axis=1, keepdims=True), share], axis=1)
    exact = np.linalg.norm(closest_points(positions, corners) - positions, axis=1)
    for position, triangle, distance in zip(positions, corners, exact, strict=True):
        brute = np.linalg.norm(weights @ triangle - position, axis=1).min()
        assert distance - 1e-9 <= brute <= distance + 0.02


def test_the_nearest_of_many_more_triangles_than_samples_is_found() -> None:
    x, y = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(0.0, 1.0, 201)]))
    vertices = np.stack([x, y, 0.05 * np.sin(6.0 * x) * np.cos(4.0 * y)], axis=1)
    triangles, rng = grid_triangles(200, 200), np.random.default_rng(12)
    surface = sample_surface(vertices, triangles, rng, 500)
    chosen = triangles[rng.permutation(len(triangles))[:300]]
    away = 0.002 * rng.choice([-1.0, 1.0], 300)
    normals = unit_normals(vertices[chosen])
    positions = vertices[chosen].mean(axis=1) + away[:, None] * normals
    distances, directions = surface.nearest(positions)
    np.testing.assert_allclose(distances, 0.002, rtol=0.01)
    np.testing.assert_allclose(directions, np.sign(away)[:, None] * normals, atol=0.05)


# ---------------------------------------------------------------------------------------------- registration


@pytest.mark.parametrize("scale", [0.0254, 1.0, 1000.0])
def test_a_rough_alignment_is_refined(scale: float) -> None:
    rng = np.random.default_rng(9)
    vertices, triangles = furnished_room()
    to_mesh = drawn_similarity(rng, scale)
    surface = sample_surface(transform_points(to_mesh, vertices), triangles, rng, 20_000)
    rough = np.eye(4)
    rough[:3, :3] = 1.01 * np.array([[1.0, -0.03, 0.0], [0.03, 1.0, 0.0], [0.0, 0.0, 1.0]])
    rough[:3, 3] = (0.06, -0.04, 0.05)
    found = refine(transform_points(to_mesh @ rough, sparse_points(rng, 200)), surface)
    back = np.linalg.inv(to_mesh) @ found.similarity @ to_mesh @ rough  # the identity, but for errors
    assert np.linalg.norm(transform_points(back, vertices) - vertices, axis=1).max() < 0.005
    assert found.error == pytest.approx(0.002 * scale, rel=0.5) and found.inliers > 0.94


def test_too_few_points_are_refused() -> None:
    surface = sample_surface(*furnished_room(), np.random.default_rng(10), 1000)
    assert error_of(refine, np.zeros((20, 3)), surface).code == "alignment-points"


# -------------------------------------------------------------------------------------------------- captures


def test_formats_without_points_cannot_be_aligned(tmp_path: Path) -> None:
    rig_writers.write_record3d(tmp_path, rig_writers.make_shots(count=1), each_frame=True)
    assert error_of(read_points, tmp_path, "record3d").code == "alignment-points"


def test_points_of_each_format(tmp_path: Path) -> None:
    """The one point that the writers add, in the coordinates of the poses."""
    shots = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), 2)
    rig_writers.write_bundler(tmp_path / "bundler", shots)
    rig_writers.write_nvm(tmp_path / "nvm", [shots[:1], shots])
    metashape_writers.write_realityscan_colmap(tmp_path / "colmap", shots)
    rig_writers.write_openmvg(tmp_path / "openmvg", shots, "pinhole", "")
    rig_writers.write_meshroom(tmp_path / "meshroom", shots, (1, 2, 8))
    edit_json(tmp_path / "openmvg" / "sfm_data.json", "structure", [{"key": 0, "value": {"X": [0.1, 0.2, 0.3]}}])
    edit_json(tmp_path / "meshroom" / "cameras.sfm", "structure", [{"X": ["0.1", "-0.2", "-0.3"]}])
    for name in ("bundler", "nvm", "colmap", "openmvg", "meshroom"):
        np.testing.assert_allclose(read_points(tmp_path / name, name), [[0.1, 0.2, 0.3]])


def edit_json(path: Path, key: str, value: object) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))


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


@pytest.mark.parametrize("scale", [0.0254, 1000.0])
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


def test_errors_of_a_pixel_cost_millimetres_and_the_wrong_pair_or_a_mirrored_mesh_is_named() -> None:
    points = np.random.default_rng(1).uniform([0, 0, 0], [5, 4, 2.6], (6, 3))
    sights = picked(points, [[index % 4, (index + 1) % 4] for index in range(6)], np.eye(4), 1.0 / 600.0)
    fit = fit_sights(sights, points)
    assert 0.001 < fit.error < 0.02 and not fit.mirrored
    assert np.linalg.norm(transform_points(fit.similarity, points) - points, axis=1).max() < 0.03
    assert fit_sights(sights, points * [1.0, -1.0, 1.0]).mirrored
    points[4] += (0.0, 0.3, 0.0)  # of the mesh alone
    assert int(fit_sights(sights, points).residuals.argmax()) == 4


@pytest.mark.parametrize(
    ("cameras", "text"),
    [
        ([[0, 1], [1, 2]], "too few"),
        ([[0], [1], [2]], "too few"),
        ([[0], [0], [0], [0], [0]], "scale"),
        ([[0, 1]] * 5, "line"),
    ],
)
def test_what_does_not_decide_the_placement_is_refused(cameras: list[list[int]], text: str) -> None:
    points = np.random.default_rng(3).uniform([0, 0, 0], [5, 4, 2.6], (len(cameras), 3))
    if text == "line":
        points = np.outer(np.linspace(0.0, 1.0, 5), [4.0, 3.0, 2.0])
    error = error_of(fit_sights, picked(points, cameras, np.eye(4)), points)
    assert error.code == "alignment-pairs" and text in error.text and error.remedy.startswith("Pick")
