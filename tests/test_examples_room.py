"""The example captures are whole, and their files, poses and ids are consistent."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
SHIPPED = EXAMPLES / "room"


@pytest.fixture(scope="module")
def files():
    """The example's own reader."""
    sys.path.insert(0, str(EXAMPLES))
    try:
        import room_files

        yield room_files
    finally:
        sys.path.remove(str(EXAMPLES))


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
        seeing += (files.read_exr(SHIPPED / "train" / "IndexMA" / f"{k:03d}_0001.exr")[..., 0] == bulb_id).any()
    assert seeing >= 6
    without = [part for part in np.unique(capture.part) if not capture.uv[capture.part == part].any()]
    assert 5 <= len(without) < len(np.unique(capture.part)) - 5
    for pose in capture.poses["train"] + capture.poses["val"]:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:3, :3]) > 0
    assert check_ids(files, SHIPPED, "val") > 1000
    means = [files.read_exr(path).astype(float).mean() for path in sorted((SHIPPED / "train" / "Image").glob("*"))]
    assert 0.2 < np.mean(means) < 3.0 and min(means) > 0.03
