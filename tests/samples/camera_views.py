"""Views with all kinds of lenses and poses, and where their pinholes project points."""

from __future__ import annotations

from typing import Any

import numpy as np

from fipt_blender.core import conventions

INTRINSICS = {
    "plain": dict(width=192, height=108, fx=150.0, fy=150.0, cx=96.0, cy=54.0),
    "off-centre": dict(width=192, height=108, fx=150.0, fy=150.0, cx=80.3, cy=61.7),
    "fx > fy": dict(width=192, height=108, fx=180.0, fy=140.0, cx=90.0, cy=50.0),
    "fx < fy": dict(width=192, height=108, fx=140.0, fy=180.0, cx=101.0, cy=57.0),
    "portrait": dict(width=108, height=192, fx=150.0, fy=155.0, cx=50.0, cy=101.0),
}


class Pinhole:
    """An entry of capture.json as `conventions` wants it."""

    def __init__(self, entry: dict[str, Any]) -> None:
        self.__dict__.update(entry)
        self.camera_to_world = np.array(entry["camera_to_world"])


def random_views() -> list[dict[str, Any]]:
    """Entries of capture.json with random poses, one for each of INTRINSICS; the first is held back."""
    random = np.random.default_rng(3)
    views = []
    for name, intrinsics in INTRINSICS.items():
        rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
        pose[:3, 3] = random.uniform(-2, 2, 3)
        views.append(
            {"name": f"train/{name}", "split": "train", "image": f"images/{name}.exr", "parts": None,
             "semantics": None, "camera_to_world": pose.tolist(), **intrinsics}
        )  # fmt: skip
    views[0]["split"] = "held_back"
    return views


def projections(entry: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of world points in front of a view."""
    pixels, depth = conventions.project(points, Pinhole(entry))
    assert (depth > 0).all()
    return pixels


def points_before(entry: dict[str, Any]) -> np.ndarray:
    """(60, 3) points spread over the image of a view, at depths of 1 to 3 m."""
    random = np.random.default_rng(5)
    pixels = random.uniform(0, 1, (60, 2)) * [entry["width"], entry["height"]]
    origins, directions = conventions.rays_at(Pinhole(entry), pixels)
    return origins + directions * random.uniform(1, 3, (60, 1))
