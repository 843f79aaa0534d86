"""Readers of solves in text files: Bundler's bundle.out, which many programs export, and VisualSFM's .nvm.

Sources: Bundler's user manual; VisualSFM's documentation, "NVM File Format" and "Camera Model". Neither has
image sizes, which are those of the photographs, nor an up axis.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from ...conventions import opengl_to_opencv_camera
from ...run.errors import FiptError
from ..places import Places
from ..rig import RigView, WellFormed
from .radial import distorting_lens, undistorting_lens
from .rig_files import Models, Program, camera_pose, number, numbers, read_text_rig, stored_rotation

LISTS = ("list.txt", "bundle.list.txt", "image_list.txt")  # of photographs, beside Bundler's file or above it
_LINES = 5  # of a camera of Bundler
_CAMERA_NUMBERS = 10  # of VisualSFM: focal length, quaternion, centre, radial distortion, 0


# -------------------------------------------------------------------------------------------------- Bundler


def _bundler(file: Path, places: Places) -> Models:
    """All cameras that Bundler could solve (their focal length is not zero).

    They look along their negative Z axis; pixels are measured from the centre.
    """
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
    return [views], ()


def _bundler_points(file: Path) -> np.ndarray:
    """The sparse points (N, 3)."""
    lines = read_text_rig(file).splitlines()
    with WellFormed(file):
        cameras, count = (int(value) for value in numbers(lines[1], 2))
        first = 2 + _LINES * cameras
        stored = [numbers(line, 3) for line in lines[first : first + 3 * count : 3]]
    return np.array(stored).reshape(-1, 3)


def _names(file: Path) -> list[str]:
    """Names of the photographs, in the order of the cameras."""
    lists = (f"{file.stem}.list.txt", f"{file.name}.list.txt", *LISTS)
    paths = [folder / name for folder in (file.parent, file.absolute().parent.parent) for name in lists]
    found = next((path for path in paths if path.is_file()), None)
    if found is None:
        raise FiptError("rig-damaged.names", file=file, lists=", ".join(LISTS))
    lines = [line.strip() for line in read_text_rig(found).splitlines() if line.strip()]
    return [_name(line) for line in lines]


def _name(line: str) -> str:
    """A name in the list, without the 0 and the focal length that may follow it."""
    words = line.rsplit(maxsplit=2)
    has_focal = len(words) == 3 and words[1] == "0" and words[2].replace(".", "", 1).isdigit()
    return words[0] if has_focal else line


def _cameras(file: Path, count: int) -> list[np.ndarray]:
    """(5, 3) numbers of each camera: focal length, k1, k2; three rows of the rotation; the translation."""
    lines = read_text_rig(file).split("\n", 2 + _LINES * count)
    with WellFormed(file):
        stated = int(numbers(lines[1], 2)[0])
        if not 0 <= stated <= count:
            raise ValueError(f"it has {stated} cameras, but its list {count} photographs")
        rows = [numbers(line, 3) for line in lines[2 : 2 + _LINES * stated]]
        if len(rows) != _LINES * stated:
            raise ValueError("it is cut off")
    return [np.stack(rows[start : start + _LINES]) for start in range(0, len(rows), _LINES)]


# ------------------------------------------------------------------------------------------------ VisualSFM


def _nvm(file: Path, places: Places) -> Models:
    """The cameras of each model.

    The principal point is the photograph's centre unless the file has a fixed calibration. A camera's radial
    distortion undoes it: undistorted = distorted (1 + r d^2), d = distorted radius over focal length.
    """
    lines = _lines(file)
    centre, aspect = _fixed_calibration(next(lines, ""))
    models = [cameras for cameras, _ in _models(lines)]
    return [[_view(places, name, values, centre, aspect) for name, values in model] for model in models], ()


def _nvm_points(file: Path) -> np.ndarray:
    """The sparse points (N, 3) of the largest model."""
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
    intrinsics = (focal, focal * aspect, cx, cy)
    lens = undistorting_lens(intrinsics, size, lambda radii: radii * (1.0 + distortion * radii**2))
    return places.view(name, size, lens, camera_pose(stored_rotation(values[1:5]), values[5:8]))


PROGRAMS = (
    Program(
        "bundler",
        "a .out file that begins with '# Bundle file', and list.txt",
        (".out",),
        lambda text: text.startswith("# Bundle file"),
        _bundler,
        _bundler_points,
        folders=(".", "bundle"),
    ),
    Program(
        "nvm",
        "an .nvm file that begins with NVM_V3",
        (".nvm",),
        lambda text: text.startswith("NVM_V3"),
        _nvm,
        _nvm_points,
    ),
)
