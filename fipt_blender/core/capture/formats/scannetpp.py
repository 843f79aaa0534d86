# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the DSLR photographs of ScanNet++: a transforms.json whose world is not that of the mesh.

Source: the ScanNet++ toolbox, which swaps X and Y and negates Z of the poses without saying so in the file.
The laser scan's mesh keeps the axes of the solve; here the poses get them again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...conventions import transform_poses
from ..options import CaptureOptions
from ..places import Places
from ..rig import Rig, find_mesh, read_json_rig
from .transforms import Frame, Transforms, frame_view

NAME = "scannetpp"
LOOKS_FOR = "dslr/nerfstudio/transforms.json"
FILES = ("dslr/nerfstudio/transforms.json", "nerfstudio/transforms.json")
MASK_FOLDER = "resized_anon_masks"
_SOLVE_FROM_STORED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])


@dataclass(frozen=True, kw_only=True)
class _Scene(Transforms):
    test_frames: tuple[Frame, ...] = ()
    has_mask: bool = True


def find(path: Path) -> Path | None:
    """The camera file of a scene, of its folder dslr, or at a path, None without one."""
    files = [path] if path.is_file() else [path / name for name in FILES]
    return next(
        (file for file in files if file.is_file() and file.parts[-2:] == ("nerfstudio", "transforms.json")),
        None,
    )


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all frames except those marked as bad; test frames are held back.

    The mesh is the laser scan's. ScanNet++ does not define an up axis.

    Raises:
        FiptError: those of `transforms.read`.
    """
    scene = read_json_rig(file, _Scene)
    dslr = file.parent.parent
    image_folders = ("hdr", "resized_images", "original_images", ".")
    places = Places(file, (dslr,), options.images, image_folders, (MASK_FOLDER,))
    views = []
    for frames, split in ((scene.frames, None), (scene.test_frames, "held_back")):
        for frame in (scene.whole(frame) for frame in frames if not frame.is_bad):
            frame = frame if scene.has_mask else replace(frame, mask_path=None)
            view = frame_view(file, frame, split, places)
            pose = transform_poses(_SOLVE_FROM_STORED, view.camera_to_world)
            views.append(replace(view, camera_to_world=pose))
    mesh = find_mesh([dslr.parent / "scans", dslr.parent], ("mesh_aligned_0.05", "mesh"))
    return places.rig(NAME, views, None, mesh)
