# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the FIPT authors' real captures: cam.txt and K_list.txt beside Image/ and segmentation/.

Both text files begin with the number of views, followed by three lines of three numbers for each view:
origin, look-at point and up vector in cam.txt, the camera matrix in K_list.txt.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import Places
from ..rig import PARTS_FOLDER, SEMANTICS_FOLDER, Lens, Rig, WellFormed, damaged
from .rig_files import read_text_rig

NAME = "fipt-real"
LOOKS_FOR = "cam.txt and K_list.txt"


def find(path: Path) -> Path | None:
    """The folder, None if it has another layout."""
    return path if (path / "cam.txt").is_file() and (path / "K_list.txt").is_file() else None


def read(path: Path, options: CaptureOptions) -> Rig:
    """Read all views; the layout defines neither splits nor an up axis.

    Raises:
        FiptError: ``rig-damaged``, ``pose-not-rotation``, ``image-size`` where an image does not fit its
            camera matrix, ``image-missing`` or ``image-unreadable``.
    """
    poses = _read_blocks(path / "cam.txt")
    matrices = _read_blocks(path / "K_list.txt")
    if len(poses) != len(matrices):
        raise damaged(path / "K_list.txt", f"{len(matrices)} camera matrices for {len(poses)} poses")
    ids = {PARTS_FOLDER: "IndexMA", SEMANTICS_FOLDER: "segmentation"}
    places = Places(path / "cam.txt", (path,), options.images, ("Image",), id_folders=ids)
    views = []
    for index, (pose, matrix) in enumerate(zip(poses, matrices, strict=True)):
        name = f"{index:03d}_0001.exr"
        size = places.size(name)
        lens = _lens(path / "K_list.txt", index, matrix, *size)
        pose = _look_at(path / "cam.txt", index, pose)
        views.append(places.view(name, size, lens, pose, called=f"{index:03d}"))
    return places.rig(NAME, views, None, places.mesh(("scene", "mesh")))


def _read_blocks(path: Path) -> np.ndarray:
    """(N, 3, 3) numbers of a file that contains N and 3 N lines."""
    with WellFormed(path):
        words = read_text_rig(path).split()
        count = int(words[0])
        values = np.array(words[1:], np.float64)
    if values.size != count * 9:
        raise damaged(path, f"{values.size} numbers instead of 9 for each of {count} views")
    return values.reshape(count, 3, 3)


def _look_at(path: Path, index: int, rows: np.ndarray) -> np.ndarray:
    """Camera-to-world (4, 4), OpenCV axes, from origin, look-at point and up vector."""
    origin, target, up = rows
    lengths = np.linalg.norm(target - origin), np.linalg.norm(up)
    if not (np.isfinite(rows).all() and min(lengths) > 0.0):
        raise damaged(path, f"view {index} has no viewing direction")
    forward = (target - origin) / lengths[0]
    up = up / lengths[1]
    # cam.txt has few digits.
    if abs(forward @ up) > 1e-2:
        raise FiptError(
            "pose-not-rotation",
            f"View {index} in {path} has an up vector that is not perpendicular to its viewing direction.",
            "Export the camera poses again.",
        )
    down = -(up - (up @ forward) * forward)
    down /= np.linalg.norm(down)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    pose[:3, 3] = origin
    return pose


def _lens(path: Path, index: int, matrix: np.ndarray, width: int, height: int) -> Lens:
    if not np.isfinite(matrix).all() or abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise damaged(path, f"the camera matrix of view {index} has skew or is not finite")
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    # The format has no image size; a principal point far from the centre indicates another size.
    if abs(cx / width - 0.5) > 0.25 or abs(cy / height - 0.5) > 0.25:
        raise FiptError(
            "image-size",
            f"View {index} is {width} x {height}, but its camera matrix has the principal point "
            f"({cx:.1f}, {cy:.1f}).",
            "Use the images that the cameras were calibrated for, or scale K_list.txt with them.",
        )
    return Lens("PINHOLE", (fx, fy, cx, cy))
