# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the export *All Data* of 3D Scanner App (Laan Labs): frame_00000.json beside frame_00000.jpg.

Source: exports of the app. ``cameraPoseARFrame`` is ARKit's camera-to-world (4, 4) by rows, ``intrinsics``
the camera matrix by rows in pixels of the photograph; axes are OpenGL's. Most frames have no photograph, but
a depth image.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...conventions import opengl_to_opencv_camera
from ..depth_images import registered_depths
from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import Lens, Rig, RigView, WellFormed, read_json_rig
from .rig_files import camera_files, head

NAME = "3d-scanner-app"
LOOKS_FOR = "frame_00000.json with cameraPoseARFrame and intrinsics"
MESHES = ("export", "textured_output", *MESH_STEMS)


@dataclass(frozen=True)
class _Frame:
    """Fields as the file names them."""

    cameraPoseARFrame: tuple[float, ...]
    intrinsics: tuple[float, ...]


def _frames(path: Path) -> list[Path]:
    return [file for file in camera_files(path, (".json",)) if file.name.startswith("frame_")]


def find(path: Path) -> Path | None:
    """The folder of the frames, or None; one frame tells."""
    folder = path.parent if path.is_file() else path
    known = any('"cameraPoseARFrame"' in head(file) for file in _frames(path)[:1])
    return folder if known else None


def read(folder: Path, options: CaptureOptions) -> Rig:
    """Read the frames with a photograph, and all depth images. The world is Y up, as in the mesh.

    Raises:
        FiptError: ``rig-damaged`` or ``depth-unreadable``.
    """
    files = _frames(folder)
    places = Places.around(files[0], options)
    shown = next((file.stem for file in files if places.find(file.stem)), files[0].stem)
    views = [_view(file, places, places.size(shown)) for file in files]
    images = [places.depth(folder, file.stem.replace("frame_", "depth_")) for file in files]
    depths = registered_depths(views, images, options.depth_unit)
    photographs = [view for view in views if not view.missing]
    return places.rig(NAME, photographs, "y", places.mesh(MESHES), depths=depths)


def _view(file: Path, places: Places, size: tuple[int, int]) -> RigView:
    frame = read_json_rig(file, _Frame)
    with WellFormed(file):
        pose = np.array(frame.cameraPoseARFrame, np.float64).reshape(4, 4)
        fx, _, cx, _, fy, cy, *_ = np.array(frame.intrinsics, np.float64).reshape(9).tolist()
    lens = Lens("PINHOLE", (fx, fy, cx, cy))
    size = places.size(file.stem) if places.find(file.stem) else size
    return places.view(file.stem, size, lens, opengl_to_opencv_camera(pose))
