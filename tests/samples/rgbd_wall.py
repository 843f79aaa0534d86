# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""RGB-D frames of a slanting wall with fine patterns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from fipt_blender.core.capture.rig import DepthView, Lens, Rig, RigView

SIZE, FOCAL = (120, 90), 105.0  # of the depth images; photographs are twice as large
NORMAL, DISTANCE = np.array([0.3, -0.2, 1.0]), 1.8  # the wall: NORMAL @ point = DISTANCE
FRAMES = 5


def pose(index: int) -> np.ndarray:
    """Camera to world: moved, turned and tilted, at several distances of the wall."""
    rng = np.random.default_rng(index)
    turn = rng.normal(0.0, 0.12, 3)
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.eye(3) + cross)[0]
    matrix[:3, :3] *= np.sign(np.diag(matrix[:3, :3]))
    matrix[:3, 3] = rng.uniform(-0.4, 0.4, 3)
    return matrix


def facing(index: int) -> np.ndarray:
    """Camera to world: moved along the wall, which it faces, so that all depths are alike."""
    axes = np.linalg.qr(np.column_stack([NORMAL, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))[0]
    axes *= np.sign(np.diag(axes[[2, 0, 1]]))
    matrix = np.eye(4)
    matrix[:3, :3] = axes[:, [1, 2, 0]]
    matrix[:3, 3] = matrix[:3, :2] @ np.random.default_rng(index).uniform(-0.4, 0.4, 2)
    return matrix


def seen_points(size: tuple[int, int], lens: tuple[float, ...], camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of a camera meet the wall (H, W, 3), and their depths (H, W)."""
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    local = np.stack([(x - lens[2]) / lens[0], (y - lens[3]) / lens[1], np.ones_like(x)], axis=2)
    direction = local @ camera[:3, :3].T
    depth = (DISTANCE - NORMAL @ camera[:3, 3]) / (direction @ NORMAL)
    return camera[:3, 3] + direction * depth[..., None], depth


def pattern(points: np.ndarray) -> np.ndarray:
    """Codes (...,) uint8 of a pattern with details of many sizes."""
    rng = np.random.default_rng(7)
    values = np.zeros(points.shape[:-1])
    for wave in 2.0 * np.pi / np.geomspace(0.04, 0.5, 24):
        direction = rng.normal(size=3)
        values += np.cos(wave * points @ (direction / np.linalg.norm(direction)) + rng.uniform(0.0, 6.0))
    return np.clip(128.0 + 18.0 * values, 0.0, 255.0).astype(np.uint8)


def write_frames(
    folder: Path,
    ratio: float,
    offset: np.ndarray,
    centre: tuple[float, float] = (3.0, -4.0),
    pose: Callable[[int], np.ndarray] = pose,
) -> Rig:
    """Frames whose photographs are made by a camera of another focal length, at `offset` from the depth's.

    Args:
        centre: of the photographs, pixels from their middle.
        pose: of each frame.
    """
    views, depths = [], []
    plain = (2 * FOCAL, 2 * FOCAL, float(SIZE[0]), float(SIZE[1]))
    true = (2 * FOCAL * ratio, 2 * FOCAL * ratio, SIZE[0] + centre[0], SIZE[1] + centre[1])
    for index in range(FRAMES):
        beside = pose(index)
        beside[:3, 3] += beside[:3, :3] @ offset
        points, _ = seen_points((2 * SIZE[0], 2 * SIZE[1]), true, beside)
        codes = np.repeat(pattern(points)[..., None], 3, axis=2)
        image = folder / f"{index}.png"
        # Exposures differ.
        Image.fromarray((codes * (0.6 + 0.03 * index)).astype(np.uint8)).save(image)
        lens = (FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2)
        _, depth = seen_points(SIZE, lens, pose(index))
        Image.fromarray(np.round(1000.0 * depth).astype(np.uint16)).save(folder / f"{index}.depth.png")
        view = RigView(str(index), None, image, 2 * SIZE[0], 2 * SIZE[1], Lens("PINHOLE", plain), pose(index))
        views.append(view)
        depths.append(DepthView(folder / f"{index}.depth.png", *SIZE, *lens, 0.001, pose(index), view))
    return Rig("rgbd", tuple(views), None, None, (), tuple(depths), True)
