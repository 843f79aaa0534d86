# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the DSLR photographs of ScanNet++: a transforms.json whose world is not that of the mesh.

Source: the ScanNet++ toolbox, which swaps X and Y and negates Z of the poses without saying so in the file.
The laser scan's mesh keeps the axes of the solve; here the poses get them again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..conventions import transform_poses
from ..run.documents import Fields, Items
from .options import CaptureOptions
from .rig import Rig, RigView, read_json_rig
from .rig_files import Places
from .transforms import FRAME, RIG, frame_view

NAME = "scannetpp"
LOOKS_FOR = "dslr/nerfstudio/transforms.json"
FILES = ("dslr/nerfstudio/transforms.json", "nerfstudio/transforms.json")
MASK_FOLDER = "resized_anon_masks"
_SOLVE_FROM_STORED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
SCENE = Fields(RIG.needed, {**RIG.optional, "test_frames": Items(FRAME), "has_mask": bool})


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
    data = read_json_rig(file, SCENE)
    dslr = file.parent.parent
    places = Places((dslr,), options.images, ("hdr", "resized_images", "original_images", "."))
    masks = dslr / MASK_FOLDER if data.get("has_mask", True) else None
    splits = (("frames", None), ("test_frames", "held_back"))
    views = [
        _view(file, {**data, **frame}, split, places, masks)
        for key, split in splits
        for frame in data.get(key, [])
        if not frame.get("is_bad")
    ]
    mesh = Places((dslr.parent,)).mesh(("mesh_aligned_0.05", "mesh"), ("scans", "."))
    return Rig(NAME, tuple(views), None, mesh)


def _view(
    file: Path, frame: dict[str, Any], split: str | None, places: Places, masks: Path | None
) -> RigView:
    image = places.image(frame["file_path"])
    view = frame_view(file, frame, split, image)
    named = places.view(frame["file_path"], (view.width, view.height), view.lens, view.camera_to_world)
    mask = frame.get("mask_path")
    return replace(
        named,
        split=split,
        camera_to_world=transform_poses(_SOLVE_FROM_STORED, view.camera_to_world),
        mask=masks / Path(mask).name if masks and mask else None,
    )
