# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Polycam's raw data (Export > Raw Data), with corrected cameras if there are any.

Source: Polycam's polyform. Cameras have OpenGL axes. ``alignmentTransform`` in mesh_info.json, by columns,
leads from their world to the mesh raw.glb, in whose coordinates the poses are returned.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...conventions import opengl_to_opencv_camera, transform_poses
from ..depth_images import registered_depths
from ..files import visible
from ..options import CaptureOptions
from ..places import Places
from ..rig import Lens, Rig, RigView, WellFormed, read_json_rig, read_pose
from .rig_files import number, pixel_size, similarity

NAME = "polycam"
LOOKS_FOR = "keyframes/corrected_cameras or keyframes/cameras with JSON files"
# Cameras and their photographs; the corrected ones are missing where Polycam could not improve its tracking.
FOLDERS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_MATRIX = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]


@dataclass(frozen=True)
class _MeshInfo:
    alignmentTransform: tuple[float, ...] | None = None


def find(path: Path) -> tuple[Path, str] | None:
    """The folder of the cameras, and the name of that of their photographs; None without."""
    for root in (path / "keyframes", path):
        for cameras, photographs in FOLDERS:
            folder = root / cameras
            if folder.is_dir() and any(file.suffix.lower() == ".json" for file in visible(folder)):
                return folder, photographs
    return None


def read(found: tuple[Path, str], options: CaptureOptions) -> Rig:
    """Read all cameras, and the depth images of the folder depth. The world is Y up, as in the mesh.

    Raises:
        FiptError: ``rig-damaged`` or ``depth-unreadable``.
    """
    cameras, photographs = found
    keyframes = cameras.parent
    folders = tuple(f"keyframes/{name}" for name in (photographs, "hdr", "exr"))
    places = Places(cameras, (keyframes.parent,), options.images, (*folders, "hdr", "exr", "."))
    files = sorted(file for file in visible(cameras) if file.suffix.lower() == ".json")
    alignment = _alignment(keyframes.parent)
    views = tuple(_view(file, places, alignment) for file in files)
    images = [places.depth(keyframes / "depth", file.stem) for file in files]
    depths = registered_depths(views, images, options.depth_unit)
    return places.rig(NAME, views, "y", places.mesh(("raw", "mesh", "scene")), depths=depths)


def _alignment(root: Path) -> np.ndarray:
    """Similarity (4, 4) from the cameras' world to the mesh; the identity where the file does not have it."""
    file = root / "mesh_info.json"
    if not file.is_file():
        return np.eye(4)
    stored = read_json_rig(file, _MeshInfo).alignmentTransform
    if stored is None:
        return np.eye(4)
    with WellFormed(file):
        matrix = np.array(stored).reshape(4, 4).T
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        return similarity(scale, matrix[:3, :3] / (scale or 1.0), matrix[:3, 3])


def _view(file: Path, places: Places, alignment: np.ndarray) -> RigView:
    data = read_json_rig(file, dict)
    with WellFormed(file):
        pose = read_pose(file, [[number(data[key]) for key in row] for row in _MATRIX])
        has_size = "width" in data and "height" in data  # missing since 2025
        size = pixel_size(data["width"], data["height"]) if has_size else places.size(file.stem)
        lens = Lens("PINHOLE", tuple(number(data[key]) for key in ("fx", "fy", "cx", "cy")))
    return places.view(file.stem, size, lens, transform_poses(alignment, opengl_to_opencv_camera(pose)))
