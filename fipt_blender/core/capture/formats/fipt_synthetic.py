# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the FIPT authors' synthetic layout: train|val/transforms.json with Image/ and id images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ...conventions import UP_AXES, fipt_to_opencv_camera
from ...run.kinds import Choice, Number
from ...run.shapes import MOST_SIDE
from ..files import name_parts, stem_of, suffix_of
from ..options import CaptureOptions
from ..places import Places
from ..rig import (
    PARTS_FOLDER,
    SEMANTICS_FOLDER,
    Lens,
    Note,
    Rig,
    RigView,
    WellFormed,
    find_mesh,
    read_json_rig,
    read_pose,
)

NAME = "fipt-synthetic"
LOOKS_FOR = "train/transforms.json beside train/Image/"
SPLITS = {"train": "train", "val": "held_back"}


@dataclass(frozen=True)
class _Frame:
    transform_matrix: list
    file_path: str | None = None


@dataclass(frozen=True)
class _Split:
    camera_angle_x: float
    frames: tuple[_Frame, ...]
    width: Annotated[float, Number(1, MOST_SIDE)] | None = None
    height: Annotated[float, Number(1, MOST_SIDE)] | None = None
    up_axis: Annotated[str, Choice(*UP_AXES)] | None = None


def find(path: Path) -> Path | None:
    """The folder of this layout, of which a path may be a split or its camera file; None without one.

    Other readers assume other camera axes.
    """
    split = path.parent if path.name == "transforms.json" else path
    root = split.parent if split.name in SPLITS and (split / "Image").is_dir() else path
    train = root / "train"
    return root if (train / "transforms.json").is_file() and (train / "Image").is_dir() else None


def read(path: Path, options: CaptureOptions) -> Rig:
    """Read the splits train and, where present, val (held back).

    Camera axes are X left, Y up, Z forward; the views of a split share one horizontal field of view, and the
    principal point is centred. The world is Y up unless the JSON has another "up_axis". IndexMA/ contains
    part ids, segmentation/ semantic ids.

    Raises:
        FiptError: ``rig-damaged``, ``image-missing``, ``image-unreadable`` or ``path-outside``.
    """
    views: list[RigView] = []
    notes: list[Note] = []
    up_axis = "y"
    for folder, split in SPLITS.items():
        json_path = path / folder / "transforms.json"
        if not json_path.is_file():
            continue
        data = read_json_rig(json_path, _Split)
        up_axis = data.up_axis or up_axis
        ids = {PARTS_FOLDER: "IndexMA", SEMANTICS_FOLDER: "segmentation"}
        places = Places(
            json_path, (path / folder,), image_folders=(".", "Image"), relative=True, id_folders=ids
        )
        own = [_view(places, split, index, frame, data) for index, frame in enumerate(data.frames)]
        rig = places.rig(NAME, own, up_axis, None)
        views += rig.views
        notes += rig.notes
    return Rig(NAME, tuple(views), up_axis, find_mesh([path], ["scene", "mesh"]), tuple(notes))


def _view(places: Places, split: str, index: int, frame: _Frame, data: _Split) -> RigView:
    """The view of the frame's file_path where it names an image, else of the authors' name by its index."""
    name = f"{index:03d}_0001.exr"
    if frame.file_path is not None and (suffix_of(frame.file_path) or places.find(frame.file_path)):
        name = frame.file_path
    with WellFormed(places.file):
        size = int(data.width or 0), int(data.height or 0)
        if not all(size):
            size = places.size(name)
        focal = 0.5 * size[0] / math.tan(0.5 * data.camera_angle_x)
    lens = Lens("PINHOLE", (focal, focal, 0.5 * size[0], 0.5 * size[1]))
    pose = fipt_to_opencv_camera(read_pose(places.file, frame.transform_matrix))
    number = stem_of(name_parts(name)[-1]).removesuffix("_0001")
    return places.view(name, size, lens, pose, called=f"{places.file.parent.name}/{number}", split=split)
