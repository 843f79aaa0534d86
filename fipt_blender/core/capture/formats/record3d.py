# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Record3D's export: metadata.json beside the folder of photographs rgb or rgbd.

Source: Record3D's .r3d format. A pose is a quaternion x, y, z, w and a position; camera axes are OpenGL's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...conventions import opengl_to_opencv_camera
from ...run.documents import decoded, read_limited
from ...run.kinds import Row
from ..depth_images import registered_depths
from ..options import CaptureOptions
from ..places import IMAGE_FOLDERS, Places
from ..rig import Lens, Note, Rig, WellFormed, damaged, read_json_rig
from .rig_files import MOST_TEXT_BYTES, pixel_size, stored_rotation

NAME = "record3d"
LOOKS_FOR = "metadata.json (or metadata) with poses, K, w and h"
FILES = ("metadata.json", "metadata", "EXR_RGBD/metadata.json")


@dataclass(frozen=True)
class _Metadata:
    """Fields as the file names them."""

    poses: tuple[tuple[float, float, float, float, float, float, float], ...]
    K: tuple[float, ...]
    w: float
    h: float
    perFrameIntrinsicCoeffs: tuple[Row, ...] | None = None


def find(path: Path) -> Path | None:
    """The metadata, None without; its keys may be anywhere, so that all of a file is searched."""
    files = [path] if path.is_file() else [path / name for name in FILES]
    for file in files:
        if file.is_file() and file.name.startswith("metadata"):
            try:
                text = decoded(read_limited(file, MOST_TEXT_BYTES))
            except ValueError:
                continue
            if '"poses"' in text and '"K"' in text:
                return file
    return None


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all frames, with the intrinsics of each where the file has them, and depth images in EXR.

    The world is Y up.

    Raises:
        FiptError: ``rig-damaged`` or ``depth-unreadable``.
    """
    data = read_json_rig(file, _Metadata)
    places = Places.around(file, options, ("rgb", "rgbd", *IMAGE_FOLDERS))
    count = len(data.poses)
    # Zero in one of two orders of storing the matrix, the principal point in the other.
    with WellFormed(file):
        fx, _, cx, _, fy, cy, column_cx, column_cy, _ = data.K
    intrinsics = data.perFrameIntrinsicCoeffs or [(fx, fy, cx + column_cx, cy + column_cy)] * count
    if len(intrinsics) != count:
        raise damaged(file, f"it has {count} poses, but intrinsics of {len(intrinsics)} frames")
    views = []
    with WellFormed(file):
        size = pixel_size(data.w, data.h)
        for index, (values, coefficients) in enumerate(zip(data.poses, intrinsics, strict=True)):
            x, y, z, w = values[:4]
            pose = np.eye(4)
            pose[:3, :3] = stored_rotation(np.array([w, x, y, z], np.float64))
            pose[:3, 3] = values[4:]
            lens = Lens("PINHOLE", coefficients)
            views.append(places.view(str(index), size, lens, opengl_to_opencv_camera(pose)))
    images = [places.depth(file.parent / "depth", str(index)) for index in range(count)]
    depths = registered_depths(views, images, options.depth_unit)
    notes: tuple[Note, ...] = ()
    if not depths and any(file.parent.glob("rgbd/*.depth")):
        text = f"The depth images beside {file} are compressed as in Record3D's .r3d, which is not read."
        notes = (Note("depth-format", text, "Export EXR + RGBD from Record3D, or give a mesh (--mesh)."),)
    return places.rig(NAME, views, "y", places.mesh(), notes, depths)
