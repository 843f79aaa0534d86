# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Bundler's bundle.out with its list of photographs, a format that many programs export.

Source: Bundler's user manual. Cameras look along their negative Z axis; pixels are measured from the centre.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...conventions import opengl_to_opencv_camera
from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import Places
from ..rig import Rig, WellFormed
from .radial import distorting_lens
from .rig_files import camera_file, camera_pose, numbers, read_text_rig

NAME = "bundler"
LOOKS_FOR = "a .out file that begins with '# Bundle file', and list.txt"
FOLDERS = (".", "bundle")
LISTS = ("list.txt", "bundle.list.txt", "image_list.txt")
_LINES = 5  # of a camera


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    return camera_file(path, (".out",), lambda text: text.startswith("# Bundle file"), FOLDERS)


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all cameras that Bundler could solve (their focal length is not zero).

    Sizes are those of the photographs, since the file has none. Bundler does not define an up axis.

    Raises:
        FiptError: ``rig-damaged``, ``image-missing`` or ``image-unreadable``.
    """
    places = Places.around(file, options, folders=FOLDERS)
    names = _names(file)
    views = []
    for name, rows in zip(names, _cameras(file, len(names)), strict=False):
        focal, k1, k2 = (float(value) for value in rows[0])
        if focal == 0.0:
            continue
        size = places.size(name)
        intrinsics = (focal, focal, 0.5 * size[0], 0.5 * size[1])
        pose = opengl_to_opencv_camera(camera_pose(rows[1:4], -rows[1:4].T @ rows[4]))
        views.append(places.view(name, size, distorting_lens(intrinsics, size, (k1, k2)), pose))
    views.sort(key=lambda view: view.name)
    return places.rig(NAME, views, None, places.mesh())


def points(file: Path) -> np.ndarray:
    """The sparse points (N, 3).

    Raises:
        FiptError: ``rig-damaged``.
    """
    lines = read_text_rig(file).splitlines()
    with WellFormed(file):
        cameras, count = (int(value) for value in numbers(lines[1], 2))
        first = 2 + _LINES * cameras
        stored = [numbers(line, 3) for line in lines[first : first + 3 * count : 3]]
    return np.array(stored).reshape(-1, 3)


def _names(file: Path) -> list[str]:
    """Names of the photographs, in the order of the cameras.

    Raises:
        FiptError: ``rig-damaged`` where no list is found.
    """
    lists = (f"{file.stem}.list.txt", f"{file.name}.list.txt", *LISTS)
    paths = [folder / name for folder in (file.parent, file.absolute().parent.parent) for name in lists]
    found = next((path for path in paths if path.is_file()), None)
    if found is None:
        raise FiptError(
            "rig-damaged",
            f"{file} has no list of its photographs beside it ({', '.join(LISTS)}).",
            "Put the list that was exported with it beside it.",
        )
    lines = [line.strip() for line in read_text_rig(found).splitlines() if line.strip()]
    return [_name(line) for line in lines]


def _name(line: str) -> str:
    """A name in the list, without the 0 and the focal length that may follow it."""
    words = line.rsplit(maxsplit=2)
    has_focal = len(words) == 3 and words[1] == "0" and words[2].replace(".", "", 1).isdigit()
    return words[0] if has_focal else line


def _cameras(file: Path, count: int) -> list[np.ndarray]:
    """(5, 3) numbers of each camera: focal length, k1, k2; three rows of the rotation; the translation.

    Raises:
        FiptError: ``rig-damaged``.
    """
    lines = read_text_rig(file).split("\n", 2 + _LINES * count)
    with WellFormed(file):
        stated = int(numbers(lines[1], 2)[0])
        if not 0 <= stated <= count:
            raise ValueError(f"it has {stated} cameras, but its list {count} photographs")
        rows = [numbers(line, 3) for line in lines[2 : 2 + _LINES * stated]]
        if len(rows) != _LINES * stated:
            raise ValueError("it is cut off")
    return [np.stack(rows[start : start + _LINES]) for start in range(0, len(rows), _LINES)]
