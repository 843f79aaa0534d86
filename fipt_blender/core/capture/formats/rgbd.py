# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for folders of registered RGB-D frames: photographs, depth images and a text file for each pose.

Two layouts: that of 7-Scenes and tsdf-fusion (frame-000000.color.jpg, .depth.png, .pose.txt beside
camera-intrinsics.txt), and that of ScanNet's exporter (folders color, depth, pose and intrinsic). Poses are
camera to world with OpenCV axes, in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...run.errors import FiptError
from ..depth_images import depth_size
from ..files import visible
from ..images import read_size
from ..options import CaptureOptions
from ..places import Places
from ..rig import DepthView, Lens, Note, Rig, RigView, WellFormed
from .rig_files import numbers, read_text_rig

NAME = "rgbd"
LOOKS_FOR = (
    "frame-*.depth.png and frame-*.pose.txt beside camera-intrinsics.txt, or folders depth, pose, color"
)
INTRINSICS = "camera-intrinsics.txt"
POSE = ".pose.txt"
MOST_POSE_BYTES = 10_000  # of a file of one frame


@dataclass(frozen=True)
class _Frame:
    """The files of a frame, and the name of its photograph, which need not exist."""

    name: str
    depth: Path | None
    pose: Path
    photograph: str


def find(path: Path) -> Path | None:
    """The folder itself or its folder data, if it has one of the layouts, else None."""
    for root in (path, path / "data"):
        if not root.is_dir():
            continue
        if all((root / name).is_dir() for name in ("depth", "pose", "intrinsic")):
            return root
        names = [path.name.lower() for path in visible(root)]
        if all(any(name.endswith(end) for name in names) for end in (POSE, ".depth.png")):
            return root
    return None


def read(root: Path, options: CaptureOptions) -> Rig:
    """Read all frames. Those without a photograph are used for their depth alone; lost poses are left out.

    Raises:
        FiptError: ``rig-damaged``, ``intrinsics-missing``, ``image-unreadable`` or ``depth-unreadable``.
    """
    places = Places(root, (root,), options.images, ("color", "."))
    frames = _frames(root, places)
    size = depth_size(next((frame.depth for frame in frames if frame.depth is not None), root / "depth"))
    depth_matrix, color_matrix = _intrinsics(root)
    views: list[RigView] = []
    depths: list[DepthView] = []
    poses = [_pose(frame.pose) for frame in frames]
    for frame, pose in zip(frames, poses, strict=True):
        photograph, view = places.find(frame.photograph), None
        if pose is None:
            continue
        if photograph is not None:
            width, height = read_size(photograph.path)  # with the same field of view
            matrix = np.diag([width / size[0], height / size[1], 1.0]) @ depth_matrix
            matrix = color_matrix if color_matrix is not None else matrix
            lens = Lens("PINHOLE", (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
            view = RigView(frame.name, None, photograph.path, width, height, lens, pose)
            views.append(view)
        if frame.depth is not None:
            intrinsics = (depth_matrix[0, 0], depth_matrix[1, 1], depth_matrix[0, 2], depth_matrix[1, 2])
            fx, fy, cx, cy = (float(value) for value in intrinsics)
            depths.append(DepthView(frame.depth, *size, fx, fy, cx, cy, options.depth_unit, pose, view))
    lost = sum(pose is None for pose in poses)
    notes: tuple[Note, ...] = ()
    if lost:
        text = f"{lost} of {len(frames)} frames have no pose, since the tracking was lost; they are left out."
        notes = (Note("pose-lost", text, "Nothing needs to be done."),)
    one_camera = color_matrix is None
    return places.rig(NAME, views, None, places.mesh(), notes, tuple(depths), one_camera)


def _frames(root: Path, places: Places) -> list[_Frame]:
    """All frames with a pose, by name."""
    if (root / "intrinsic").is_dir():
        poses = [file for file in visible(root / "pose") if file.suffix.lower() == ".txt"]
        found = [
            _Frame(pose.stem, places.depth(root / "depth", pose.stem), pose, pose.stem) for pose in poses
        ]
        # Frames are numbered without leading zeros.
        return sorted(found, key=lambda frame: (len(frame.name), frame.name))
    poses = sorted(file for file in visible(root) if file.name.lower().endswith(POSE))
    stems = [pose.name[: -len(POSE)] for pose in poses]
    return [
        _Frame(stem, places.depth(root, f"{stem}.depth"), pose, f"{stem}.color")
        for stem, pose in zip(stems, poses, strict=True)
    ]


def _intrinsics(root: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Camera matrices of the depth images, and of the photographs where they have their own.

    Raises:
        FiptError: ``intrinsics-missing`` or ``rig-damaged``.
    """
    if (root / "intrinsic").is_dir():
        depth, color = (root / "intrinsic" / f"intrinsic_{kind}.txt" for kind in ("depth", "color"))
        return _matrix(depth), _matrix(color) if color.is_file() else None
    return _matrix(root / INTRINSICS), None


def _matrix(path: Path) -> np.ndarray:
    if not path.is_file():
        raise FiptError(
            "intrinsics-missing",
            f"{path} does not exist.",
            "Write the three rows of the depth camera's matrix into this file.",
        )
    text = read_text_rig(path, MOST_POSE_BYTES)
    side = 4 if len(text.split()) == 16 else 3
    with WellFormed(path):
        return numbers(text, side * side).reshape(side, side)[:3, :3]


def _pose(path: Path) -> np.ndarray | None:
    """A pose (4, 4), or None where the tracking was lost, which programs write as infinity or NaN.

    Raises:
        FiptError: ``rig-damaged``.
    """
    words = read_text_rig(path, MOST_POSE_BYTES).split()
    with WellFormed(path):
        values = np.array([float(word) for word in words], np.float64).reshape(4, 4)
    return values if np.isfinite(values).all() else None
