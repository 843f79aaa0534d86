# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for the FIPT authors' synthetic layout: train|val/transforms.json with Image/ and id images."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..conventions import fipt_to_opencv_camera
from ..run.documents import Fields, Items, Maybe, Number
from ..run.shapes import MOST_SIDE
from .images import read_size
from .options import CaptureOptions
from .rig import PHOTO_SUFFIXES, Lens, Rig, RigView, WellFormed, find_mesh, read_json_rig, read_pose
from .rig_files import refuse_outside

NAME = "fipt-synthetic"
LOOKS_FOR = "train/transforms.json beside train/Image/"
SPLITS = {"train": "train", "val": "held_back"}
RIG = Fields(
    {
        "camera_angle_x": Number(),
        "frames": Items(Fields({"transform_matrix": list}, {"file_path": Maybe(str)})),
    },
    {"width": Number(1, MOST_SIDE), "height": Number(1, MOST_SIDE), "up_axis": str},
)


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
    up_axis = "y"
    for folder, split in SPLITS.items():
        json_path = path / folder / "transforms.json"
        if not json_path.is_file():
            continue
        data = read_json_rig(json_path, RIG)
        up_axis = data.get("up_axis", up_axis)
        for index, frame in enumerate(data["frames"]):
            views.append(_view(json_path, split, _image(json_path, index, frame, options), frame, data))
    return Rig(NAME, tuple(views), up_axis, find_mesh([path], ["scene", "mesh"]))


def _view(json_path: Path, split: str, image: Path, frame: dict[str, Any], data: dict[str, Any]) -> RigView:
    root = json_path.parent
    number = image.stem.removesuffix("_0001")
    with WellFormed(json_path):
        if "width" in data and "height" in data:
            width, height = int(data["width"]), int(data["height"])
        else:
            width, height = read_size(image)
        focal = 0.5 * width / math.tan(0.5 * float(data["camera_angle_x"]))
    parts = root / "IndexMA" / f"{image.stem}.exr"
    semantics = root / "segmentation" / f"{number}.exr"
    return RigView(
        name=f"{root.name}/{number}",
        split=split,
        image=image,
        width=width,
        height=height,
        lens=Lens("PINHOLE", (focal, focal, 0.5 * width, 0.5 * height)),
        camera_to_world=fipt_to_opencv_camera(read_pose(json_path, frame["transform_matrix"])),
        parts=parts if parts.is_file() else None,
        semantics=semantics if semantics.is_file() else None,
    )


def _image(json_path: Path, index: int, frame: dict[str, Any], options: CaptureOptions) -> Path:
    """The frame's file_path where it names an image, else the authors' name by position in the list."""
    file_path = frame.get("file_path")
    if isinstance(file_path, str) and file_path.lower().endswith(PHOTO_SUFFIXES):
        refuse_outside(json_path, file_path, options)
        return json_path.parent / file_path
    return json_path.parent / "Image" / f"{index:03d}_0001.exr"
