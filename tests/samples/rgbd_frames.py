# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of RGB-D frames of a wall, as tsdf-fusion and ScanNet's exporter lay them out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

WALL = 2.0  # metres in front of the cameras


def frame_pose(index: int) -> np.ndarray:
    """Camera to world of a frame: the cameras stand side by side and look along Z."""
    matrix = np.eye(4)
    matrix[0, 3] = 0.1 * index
    return matrix


def write_depth(path: Path, size: tuple[int, int], depth: float = WALL) -> None:
    """A depth image in millimetres; eight rows at the top have no measurement, by either code."""
    values = np.full((size[1], size[0]), round(depth * 1000.0), np.uint16)
    values[:4] = 0
    values[4:8] = 65535
    Image.fromarray(values).save(path)


def write_color(path: Path, size: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(60, 180, (size[1], size[0], 3), np.uint8)
    Image.fromarray(noise).save(path)


def write_frames(folder: Path, count: int, size: tuple[int, int], focal: float) -> Path:
    """The layout of tsdf-fusion; the photographs have twice the resolution of the depth images."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = np.array([[focal, 0.0, size[0] / 2], [0.0, focal, size[1] / 2], [0.0, 0.0, 1.0]])
    np.savetxt(folder / "camera-intrinsics.txt", camera, "%.9f")
    for index in range(count):
        stem = f"frame-{index:06d}"
        write_depth(folder / f"{stem}.depth.png", size)
        write_color(folder / f"{stem}.color.png", (2 * size[0], 2 * size[1]))
        np.savetxt(folder / f"{stem}.pose.txt", frame_pose(index), "%.9f")
    return folder


def write_exported_scan(folder: Path, size: tuple[int, int], focal: float) -> Path:
    """The layout of ScanNet's exporter; frame 10 follows 9 although its name sorts before."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for kind, length in (("depth", focal), ("color", 2.5 * focal)):
        matrix = np.diag([length, length, 1.0, 1.0])
        matrix[:2, 2] = 30.0, 20.0
        np.savetxt(folder / "intrinsic" / f"intrinsic_{kind}.txt", matrix, "%.9f")
    for index in (9, 10):
        write_depth(folder / "depth" / f"{index}.png", size)
        write_color(folder / "color" / f"{index}.jpg", (160, 120))
        np.savetxt(folder / "pose" / f"{index}.txt", frame_pose(index), "%.9f")
    return folder
