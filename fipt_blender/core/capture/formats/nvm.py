# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for VisualSFM's N-View Match files (.nvm).

Source: VisualSFM's documentation, "NVM File Format" and "Camera Model". The radial distortion of a camera
undoes the distortion: undistorted = distorted (1 + r d^2), with d the distorted radius over the focal length.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ..options import CaptureOptions
from ..places import Places
from ..rig import Rig, RigView, WellFormed
from .radial import undistorting_lens
from .rig_files import (
    camera_file,
    camera_pose,
    largest_model,
    number,
    numbers,
    read_text_rig,
    stored_rotation,
)

NAME = "nvm"
LOOKS_FOR = "an .nvm file that begins with NVM_V3"
_CAMERA_NUMBERS = 10  # focal length, quaternion, centre, radial distortion, 0


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    return camera_file(path, (".nvm",), lambda text: text.startswith("NVM_V3"))


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all cameras of the largest model.

    Sizes are those of the photographs, since the file has none. The principal point is their centre unless
    the file has a fixed calibration. VisualSFM does not define an up axis.

    Raises:
        FiptError: ``rig-damaged``, ``camera-model``, ``image-missing`` or ``image-unreadable``.
    """
    places = Places.around(file, options)
    lines = _lines(file)
    with WellFormed(file):
        centre, aspect = _fixed_calibration(next(lines, ""))
        entries = [cameras for cameras, _ in _models(lines)]
    models = [[_view(places, name, values, centre, aspect) for name, values in model] for model in entries]
    views, notes = largest_model(models, str(file))
    return places.rig(NAME, views, None, places.mesh(), notes)


def points(file: Path) -> np.ndarray:
    """The sparse points (N, 3) of the largest model.

    Raises:
        FiptError: ``rig-damaged``.
    """
    lines = _lines(file)
    next(lines, "")
    with WellFormed(file):
        _, stored = max(_models(lines), key=lambda model: len(model[0]))
        return np.array([numbers(line.split()[:3], 3) for line in stored]).reshape(-1, 3)


def _lines(file: Path) -> Iterator[str]:
    """Lines of the file that are neither empty nor comments."""
    lines = (line.strip() for line in read_text_rig(file).splitlines())
    return (line for line in lines if line and not line.startswith("#"))


def _fixed_calibration(line: str) -> tuple[tuple[float, float] | None, float]:
    """Principal point in pixels, or None for the image's centre, and fy over fx, of the first line."""
    words = line.split()
    if "FixedK" not in words:
        return None, 1.0
    fx, cx, fy, cy, _ = numbers(words[words.index("FixedK") + 1 :][:5], 5)
    if not (fx > 0.0 and fy > 0.0):
        raise ValueError("the fixed calibration has no focal length")
    return (float(cx), float(cy)), float(fy / fx)


def _models(lines: Iterator[str]) -> list[tuple[list[tuple[str, np.ndarray]], list[str]]]:
    """Names and numbers of the cameras of each model, and the lines of its points.

    Raises:
        ValueError: what is wrong.
    """
    models = []
    while (count := _count(next(lines, "0"))) > 0:
        cameras = [_camera(next(lines, "")) for _ in range(count)]
        expected = _count(next(lines, "0"))
        stored = list(islice(lines, expected)) if expected <= sys.maxsize else []
        if len(stored) != expected:
            raise ValueError("it is cut off")
        models.append((cameras, stored))
    return models


def _count(line: str) -> int:
    value = number(line)
    if not value.is_integer() or value < 0:
        raise ValueError(f"{line[:40]!r} is no count")
    return int(value)


def _camera(line: str) -> tuple[str, np.ndarray]:
    words = line.rsplit(maxsplit=_CAMERA_NUMBERS)
    if len(words) != _CAMERA_NUMBERS + 1:
        raise ValueError(f"the line {line[:40]!r} is no camera")
    values = numbers(words[1:], _CAMERA_NUMBERS)
    if not values[0] > 0.0 or not values[1:5].any():
        raise ValueError(f"the camera {words[0][:40]!r} has no focal length or no rotation")
    return words[0].replace('"', " "), values  # VisualSFM writes blanks in names as quotation marks


def _view(
    places: Places, name: str, values: np.ndarray, centre: tuple[float, float] | None, aspect: float
) -> RigView:
    size = places.size(name)
    focal, distortion = float(values[0]), float(values[8])
    cx, cy = centre or (0.5 * size[0], 0.5 * size[1])
    lens = undistorting_lens((focal, focal * aspect, cx, cy), size, partial(_undistorted, distortion))
    return places.view(name, size, lens, camera_pose(stored_rotation(values[1:5]), values[5:8]))


def _undistorted(distortion: float, radii: np.ndarray) -> np.ndarray:
    return radii * (1.0 + distortion * radii**2)
