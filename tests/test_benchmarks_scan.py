"""The benchmark's scanner has the noise that it states."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scan import Scanner, believed_pose, disturbed, read_truth, smoothed
from fipt_blender.core.capture.views import View
from fipt_blender.core.depth.extraction import FusedMesh
from samples.scans import grid_triangles


def test_ranges_of_a_wall_have_the_noise_that_the_scanner_states() -> None:
    scanner = Scanner(noise=0.004, relative_noise=0.002)
    distance = np.full((200, 200), 3.0)
    found = disturbed(distance, distance > 0.0, scanner, np.random.default_rng(0)) - distance
    assert found.std() == pytest.approx(0.004 + 0.002 * 3.0, rel=0.05) and abs(found.mean()) < 2e-4


def test_flying_pixels_lie_between_both_sides_of_a_depth_edge_and_nowhere_else() -> None:
    distance = np.full((100, 100), 2.0)
    distance[:, 50:] = 3.0
    scanner = Scanner(noise=0.0, relative_noise=0.0, flying=0.5)
    found = disturbed(distance, distance > 0.0, scanner, np.random.default_rng(0))
    flying = (found > 2.0) & (found < 3.0)
    assert 25 < flying[:, 50].sum() < 75
    away = np.ones(100, bool)
    away[[0, 50]] = False  # the first column's neighbour is the last one, as images are rolled
    assert np.array_equal(found[:, away], distance[:, away])


def test_smoothing_flattens_noise_and_keeps_the_place() -> None:
    x, y = np.meshgrid(np.arange(20), np.arange(20), indexing="ij")
    noise = np.random.default_rng(0).normal(0.0, 0.1, x.size)
    vertices = np.stack([x.ravel(), y.ravel(), noise], axis=1).astype(np.float32)
    mesh = FusedMesh(vertices, grid_triangles(19, 19).astype(np.int32))
    found = smoothed(mesh, 5).vertices
    assert found[:, 2].std() < 0.5 * noise.std()
    assert np.abs(found.mean(axis=0) - vertices.mean(axis=0)).max() < 0.05
    assert np.array_equal(smoothed(mesh, 0).vertices, vertices)


def test_poses_are_wrong_by_what_the_scanner_states() -> None:
    view = View("a", "train", Path("a.exr"), 4, 4, 4.0, 4.0, 2.0, 2.0, np.eye(4))
    rng = np.random.default_rng(0)
    scanner = Scanner(drift=0.002, tilt=0.1)
    poses = np.array([believed_pose(view, scanner, rng) for _ in range(2000)])
    assert poses[:, :3, 3].std(axis=0) == pytest.approx(0.002, rel=0.1)
    assert np.degrees(poses[:, 0, 1].std()) == pytest.approx(0.1, rel=0.1)
    assert np.array_equal(believed_pose(view, Scanner(), rng), np.eye(4))


def write_small_truth(folder: Path, first_id: int) -> None:
    """Two triangles: the first of a dark material, the second of a textured shiny one."""
    folder.mkdir()
    (folder / "scene.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    emits, material = np.array([False, True]), np.array([first_id, first_id + 1])
    np.savez(folder / "scene.npz", material=material, is_emitter=emits)
    materials = [
        {"id": 1, "base_color": [0.01, 0.02, 0.01], "texture": None, "roughness": 1.0},
        {"id": 2, "base_color": [0.5, 0.5, 0.5], "texture": "a.png", "roughness": 0.1},
    ]
    (folder / "materials.json").write_text(json.dumps({"materials": materials}))


@pytest.mark.parametrize("first_id", [0, 1], ids=["places in the list", "ids"])
def test_materials_are_found_by_either_numbering(tmp_path: Path, first_id: int) -> None:
    write_small_truth(tmp_path / "room", first_id)
    truth = read_truth(tmp_path / "room")
    assert truth.reflectance.tolist() == [0.02, 1.0] and truth.roughness.tolist() == [1.0, 0.1]
    assert truth.emits.tolist() == [False, True]
