# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The example capture: its script builds a tiny version whose files, poses and ids are consistent."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
SHIPPED = EXAMPLES / "room"
WIDTH, HEIGHT = 32, 18


@pytest.fixture(scope="module")
def files():
    """The example's own reader."""
    sys.path.insert(0, str(EXAMPLES))
    try:
        import room_files

        yield room_files
    finally:
        sys.path.remove(str(EXAMPLES))


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> Path:
    """The room rendered with 2 training views and 1 held-back one."""
    folder = tmp_path_factory.mktemp("room")
    script = [sys.executable, str(EXAMPLES / "make_room.py"), "--out", str(folder), "--views", "2"]
    result = subprocess.run(
        [*script, "--size", f"{WIDTH}x{HEIGHT}", "--spp", "4", "--seed", "3"],
        capture_output=True, text=True, timeout=1500, env=os.environ,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr
    return folder


def project(points: np.ndarray, pose: np.ndarray, fov_x: float, width: int, height: int) -> np.ndarray:
    """Pixel coordinates and depth (N, 3) of world points; camera axes X left, Y up, Z forward."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    focal = width / 2 / np.tan(fov_x / 2)
    x = width / 2 - focal * local[:, 0] / local[:, 2]
    y = height / 2 - focal * local[:, 1] / local[:, 2]
    return np.stack([x, y, local[:, 2]], -1)


def check_ids(files, folder: Path, split: str) -> int:
    """Unoccluded centroids of large triangles show the id of their own material."""
    capture = files.read_capture(folder)
    centroids = capture.corners.mean(1)
    checked = 0
    for k, pose in enumerate(capture.poses[split]):
        ids = files.read_exr(folder / split / "IndexMA" / f"{k:03d}_0001.exr")[..., 0].astype(int)
        x, y, depth = project(centroids, pose, capture.fov_x, capture.width, capture.height).T
        inside = (depth > 0.1) & (x > 2) & (y > 2) & (x < capture.width - 2) & (y < capture.height - 2)
        column, row = x[inside].astype(int), y[inside].astype(int)
        # A pixel whose neighbours all have one id, with the nearest centroid that projects into it
        nearest: dict[tuple[int, int], tuple[float, int]] = {}
        for c, r, d, m in zip(column, row, depth[inside], capture.material[inside], strict=True):
            block = ids[r - 1 : r + 2, c - 1 : c + 2]
            if (block == block[0, 0]).all() and d < nearest.get((r, c), (np.inf, 0))[0]:
                nearest[r, c] = (d, m)
        agree = [ids[at] == material for at, (_, material) in nearest.items()]
        checked += len(agree)
        assert np.mean(agree) > 0.6, f"{split} {k}: ids and geometry disagree"
    return checked


def test_tiny_build_has_every_file(tiny, files):
    """The layout of the paper's synthetic data, for training, held-back and relit views."""
    for split, count in (("train", 2), ("val", 1)):
        cameras = json.loads((tiny / split / "transforms.json").read_text())
        assert (cameras["width"], cameras["height"], len(cameras["frames"])) == (WIDTH, HEIGHT, count)
        maps = ["Image", "BaseColor", "DiffCol", "Metallic", "Roughness", "Emit", "IndexMA", "IndexOB"]
        maps += ["albedo", "segmentation"] + (["Normal", "Depth"] if split == "val" else [])
        for name in maps:
            images = sorted((tiny / split / name).glob("*.exr"))
            assert len(images) == count, name
            value = files.read_exr(images[0])
            assert value.shape[:2] == (HEIGHT, WIDTH) and np.isfinite(value.astype(float)).all(), name
    for view in json.loads((tiny / "relight.json").read_text())["views"]:
        assert files.read_exr(tiny / view["image"]).mean() > 0.01
    assert (tiny / "sheet.png").stat().st_size > 1000


def test_ids_lie_where_the_geometry_is(tiny, files):
    """Scene, poses and images use the same axes: known 3D points project onto their own part."""
    assert check_ids(files, tiny, "train") > 30


def test_maps_follow_the_materials(tiny, files):
    """Inside a material every map has that material's value; emission agrees with emitters.json."""
    capture = files.read_capture(tiny)
    table = {m["id"]: m for m in capture.materials}

    def load(name: str) -> np.ndarray:
        return files.read_exr(tiny / "val" / name / "000_0001.exr").astype(float)

    ids, roughness, metallic, base = (load(n) for n in ("IndexMA", "Roughness", "Metallic", "BaseColor"))
    np.testing.assert_allclose(load("DiffCol").mean(), (base * (1 - metallic)).mean(), rtol=0.05)
    whole = 0
    for row in range(1, HEIGHT - 1):
        for column in range(1, WIDTH - 1):
            block = ids[row - 1 : row + 2, column - 1 : column + 2, 0]
            material = table[int(block[1, 1])]
            same = (roughness[row, column] == roughness[row, column, 0]).all()
            if (block == block[0, 0]).all() and same and material["roughness"] == 1.0:
                whole += abs(roughness[row, column, 0] - 1.0) < 1e-3
    assert whole > 20
    a_prime = files.read_exr(tiny / "val" / "albedo" / "000.exr").astype(float)
    assert a_prime.max() <= 1.001 and (a_prime >= load("DiffCol") - 2e-3).all()


def test_thin_things_are_thin_and_have_their_own_materials(tmp_path, files):
    """They follow the plain room's materials, lie within the room, and are slight beside a footprint."""
    command = [sys.executable, str(EXAMPLES / "make_room.py"), "--out", str(tmp_path)]
    command += ["--views", "1", "--seed", "3", "--thin", "--no-render"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=1500)
    assert result.returncode == 0, result.stdout + result.stderr
    plain = json.loads((SHIPPED / "materials.json").read_text())["materials"]
    table = json.loads((tmp_path / "materials.json").read_text())
    added = table["materials"][len(plain) :]
    assert "--thin" in table["command"] and len(added) > 10
    assert [row["name"] for row in table["materials"][: len(plain)]] == [row["name"] for row in plain]
    capture = files.read_capture(tmp_path)
    thin = np.isin(capture.material, [row["id"] for row in added])
    assert all(row["triangles"] == (capture.material == row["id"]).sum() > 0 for row in added)
    low, high = (capture.corners[~thin].reshape(-1, 3).min(0), capture.corners[~thin].reshape(-1, 3).max(0))
    assert (capture.corners[thin] >= low).all() and (capture.corners[thin] <= high).all()
    corners = capture.corners[thin].astype(float)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    pixel = 2 * np.tan(capture.fov_x / 2) / 192  # metres, one metre from a camera of the shipped capture
    assert np.mean(doubled / sides.max(1) < 3 * pixel) > 0.95
    strips = [emitter for emitter in capture.emitters if emitter["name"].endswith("StripLight")]
    assert len(strips) == 3 and len(capture.emitters) == 5
    for strip in strips:
        first, end = strip["triangles"]
        assert len(np.unique(capture.material[first:end])) == 1 and strip["area"] < 0.12


def test_shipped_capture_is_whole(files):
    """40 + 6 views under 15 MB; the bulb is seen by at least 6 training views; some objects have no UVs."""
    size = sum(path.stat().st_size for path in SHIPPED.rglob("*") if path.is_file())
    assert size < 15e6
    capture = files.read_capture(SHIPPED)
    assert [len(capture.poses[split]) for split in ("train", "val")] == [40, 6]
    bulb = next(emitter for emitter in capture.emitters if emitter["name"] == "BulbLight")
    first, end = bulb["triangles"]
    bulb_id = capture.material[first]
    assert (capture.material[first:end] == bulb_id).all() and 0.004 < bulb["area"] < 0.02
    seeing = 0
    for k in range(40):
        seeing += (
            files.read_exr(SHIPPED / "train" / "IndexMA" / f"{k:03d}_0001.exr")[..., 0] == bulb_id
        ).any()
    assert seeing >= 6
    without = [part for part in np.unique(capture.part) if not capture.uv[capture.part == part].any()]
    assert 5 <= len(without) < len(np.unique(capture.part)) - 5
    for pose in capture.poses["train"] + capture.poses["val"]:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:3, :3]) > 0
    assert check_ids(files, SHIPPED, "val") > 1000
    means = [
        files.read_exr(path).astype(float).mean() for path in sorted((SHIPPED / "train" / "Image").glob("*"))
    ]
    assert 0.2 < np.mean(means) < 3.0 and min(means) > 0.03


def test_the_small_example_shows_its_frames(files):
    """They look into the room, which Blender shows from its front only; all else is as in the large room."""
    small = SHIPPED.parent.parent / "fipt_blender" / "example"
    old, new = (files.read_obj(folder / "scene.obj") for folder in (SHIPPED, small))
    materials = [
        line.split()[1]
        for line in (small / "scene.obj").read_text(encoding="utf-8").splitlines()
        if line.startswith("usemtl ")
    ]
    assert {"GiltFrame", "BlackFrame", "Mount"} <= set(materials)
    turned = (old[0] != new[0]).any((1, 2))
    assert turned.sum() == 4 * 48 + 2 * 8  # of the mirror and three pictures, two with a mount
    for before, after in zip(old, new, strict=True):
        assert np.array_equal(before[~turned], after[~turned])
    assert np.array_equal(old[0][turned][:, ::-1], new[0][turned])
    assert np.array_equal(old[1][turned][:, ::-1], -new[1][turned])
    corners, normals = new[0][turned], new[1][turned]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("tk,tck->tc", facing, normals) >= 0.0).all()
    inward = -np.sign(corners.mean(1)[:, 0])  # they hang on the walls at both ends of X
    assert (inward * facing[:, 0] > -1e-9).mean() > 0.6 and (inward * facing[:, 0]).sum() > 0.0
