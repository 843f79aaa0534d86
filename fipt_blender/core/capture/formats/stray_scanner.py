# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Stray Scanner's folders: odometry.csv, camera_matrix.csv, depth, confidence and rgb.mp4.

Source: the app's documentation. A row has a frame's position and quaternion x, y, z, w from camera to world,
with OpenCV's axes; the matrix is that of the video, whose pictures must be extracted to the folder rgb.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ...run.errors import FiptError
from ..depth_images import registered_depths
from ..options import CaptureOptions
from ..places import Places
from ..rig import Lens, Rig, WellFormed
from .rig_files import camera_pose, number, numbers, read_text_rig, stored_rotation

NAME = "stray-scanner"
LOOKS_FOR = "odometry.csv and camera_matrix.csv"


def find(path: Path) -> Path | None:
    """The folder of the odometry, or None."""
    folder = path if path.is_dir() else path.parent
    return (
        folder if all((folder / name).is_file() for name in ("odometry.csv", "camera_matrix.csv")) else None
    )


def read(folder: Path, options: CaptureOptions) -> Rig:
    """Read the frames whose pictures were extracted, and all depth images. The world's up axis is found.

    Raises:
        FiptError: ``rig-damaged``, ``image-missing`` or ``depth-unreadable``.
    """
    file = folder / "odometry.csv"
    places = Places(file, (folder,), options.images, ("rgb", "images", "."))
    with WellFormed(file):
        text = read_text_rig(folder / "camera_matrix.csv").replace(",", " ")
        fx, _, cx, _, fy, cy, *_ = numbers(text, 9).tolist()
        rows = list(csv.DictReader(read_text_rig(file).splitlines(), skipinitialspace=True))
        poses = {}
        for row in rows:
            values = np.array([number(row[name]) for name in ("qw", "qx", "qy", "qz", "x", "y", "z")])
            poses[row["frame"].strip()] = camera_pose(stored_rotation(values[:4]).T, values[4:])
    shown = next((name for name in poses if places.find(name)), None)
    if shown is None:
        raise FiptError(
            "image-missing",
            f"{folder} has its photographs in a video, rgb.mp4.",
            "Make a folder rgb there, and extract them: ffmpeg -i rgb.mp4 -start_number 0 rgb/%06d.jpg",
        )
    lens, size = Lens("PINHOLE", (fx, fy, cx, cy)), places.size(shown)
    views = [places.view(name, size, lens, pose) for name, pose in poses.items()]
    images = [places.depth(folder / "depth", name) for name in poses]
    depths = registered_depths(views, images, options.depth_unit)
    photographs = [view for view in views if not view.missing]
    return places.rig(NAME, photographs, None, places.mesh(), depths=depths)
