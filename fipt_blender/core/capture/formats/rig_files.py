"""Camera files of other programs: how they are recognized, and read within limits.

Formats whose cameras are in one file of a program that solves them are a `Program`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ...alignment.turns import quaternion_rotation
from ...run.documents import decoded, read_limited
from ...run.errors import FiptError, Problem, problem
from ...run.shapes import MOST_SIDE
from ..files import visible
from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import Rig, RigView, WellFormed, damaged

MOST_TEXT_BYTES = 256_000_000  # of a camera file


# ------------------------------------------------------------------------------------------------ recognition


def head(path: Path) -> str:
    """The beginning of a file as text, for recognizing its format; empty where it can't be read."""
    try:
        with path.open("rb") as file:
            return decoded(file.read(1 << 16), errors="replace")
    except OSError:
        return ""


def camera_files(path: Path, suffixes: Iterable[str], folders: Sequence[str] = (".",)) -> Iterator[Path]:
    """The file itself, or those in a folder and some below it, that have one of the suffixes, by name."""
    wanted = tuple(suffixes)
    if path.is_file():
        if path.suffix.lower() in wanted:
            yield path
        return
    for folder in folders:
        if (path / folder).is_dir():
            for entry in visible(path / folder):
                if entry.suffix.lower() in wanted and entry.is_file():
                    yield entry


def camera_file(
    path: Path, suffixes: Iterable[str], known: Callable[[str], bool], folders: Sequence[str] = (".",)
) -> Path | None:
    """The first of these files whose beginning is known, None without one."""
    return next((file for file in camera_files(path, suffixes, folders) if known(head(file))), None)


# ---------------------------------------------------------------------------------------------------- reading


def read_text_rig(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """The text of a camera file."""
    if not path.is_file():
        raise damaged(path, "it contains no camera file")
    with WellFormed(path):
        return decoded(read_limited(path, most_bytes)).replace("\r\n", "\n")


def read_xml_rig(path: Path) -> ElementTree.Element:
    """The root element of an XML file without a document type, whose entities could expand without end."""
    text = read_text_rig(path, 64_000_000)  # a parsed document takes about ten times its size
    if "<!DOCTYPE" in text:
        raise damaged(path, "it declares a document type")
    with WellFormed(path):
        return ElementTree.fromstring(text)


def number(value: Any) -> float:
    """A finite number; programs also write numbers as texts.

    Raises:
        ValueError: for anything else.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"{str(value)[:40]!r} is not a number")
    try:
        result = float(value)
    except (OverflowError, ValueError):
        result = math.nan
    if not math.isfinite(result):
        raise ValueError(f"{str(value)[:40]!r} is not a finite number")
    return result


def numbers(value: Any, count: int) -> np.ndarray:
    """(count,) float64 of a list of numbers, or of a text with numbers between blanks.

    Raises:
        ValueError: where it has another length or other content.
    """
    items = value.split() if isinstance(value, str) else value
    if not isinstance(items, list) or len(items) != count:
        raise ValueError(f"{str(value)[:40]!r} should be {count} numbers")
    return np.array([number(item) for item in items], np.float64)


def pixel_size(width: Any, height: Any) -> tuple[int, int]:
    """Width and height of an image in pixels.

    Raises:
        ValueError: for sizes that no image has.
    """
    sides = number(width), number(height)
    if not all(1.0 <= side <= MOST_SIDE for side in sides):
        raise ValueError(f"an image of {sides[0]:g} x {sides[1]:g} pixels")
    return int(sides[0]), int(sides[1])


# ------------------------------------------------------------------------------------------------------ poses


def camera_pose(world_to_camera: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Camera-to-world (4, 4) float64 of the rotation (3, 3) from world to camera and the centre (3,)."""
    pose = np.eye(4)
    pose[:3, :3] = world_to_camera.T
    pose[:3, 3] = centre
    return pose


def stored_rotation(wxyz: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a quaternion w, x, y, z of any length above zero.

    Raises:
        ValueError: for a quaternion of zeros.
    """
    largest = float(np.abs(wxyz).max())
    if not largest > 0.0:
        raise ValueError("a quaternion is zero")
    scaled = wxyz / largest  # the squares of numbers below 1e-154 are zero
    return quaternion_rotation(scaled / np.linalg.norm(scaled))


def similarity(scale: float, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Similarity (4, 4) of a scale, a rotation (3, 3) and a translation (3,).

    Raises:
        ValueError: for a scale that is not positive, or a matrix that is no rotation.
    """
    off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if not scale > 0.0 or off > 1e-3 or np.linalg.det(rotation) < 0.0:
        raise ValueError("a transform is no rotation with a positive scale")
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = translation
    return matrix


def unsupported(file: Path, what: str, remedy: str) -> FiptError:
    """The error for a camera that no pinhole or no model of COLMAP's describes."""
    return FiptError("camera-model.unsupported", file=file, what=what, remedy=remedy)


def cameras_off(file: Path, names: Sequence[str]) -> tuple[Problem, ...]:
    """A warning of cameras that are switched off in the program that wrote a file; none without any."""
    if not names:
        return ()
    shown = ", ".join(names[:3]) + (", and others" if len(names) > 3 else "")
    return (problem("cameras-off", number_of_names=len(names), file=file, shown=shown),)


def largest_model(
    models: Sequence[Sequence[RigView]], source: str
) -> tuple[tuple[RigView, ...], tuple[Problem, ...]]:
    """The views of the model with the most views, and a warning where there are others.

    Args:
        models: the views of each model that the solver could not connect with the others.
        source: what holds them, for the warning.
    """
    filled = [model for model in models if model]
    if not filled:
        return (), ()
    chosen = max(filled, key=len)
    if len(filled) == 1:
        return tuple(chosen), ()
    sizes = ", ".join(str(len(model)) for model in filled)
    note = problem("several-models.largest-model", source=source, number_of_filled=len(filled), sizes=sizes)
    return tuple(chosen), (note,)


# The views of each model that the solver could not connect with the others, and warnings.
Models = tuple[Sequence[Sequence[RigView]], tuple[Problem, ...]]


@dataclass(frozen=True)
class Program:
    """A format of `registry`."""

    # NAME, LOOKS_FOR: see `registry`
    NAME: str
    LOOKS_FOR: str
    suffixes: tuple[str, ...]  # of the camera file
    known: Callable[[str], bool]  # whether a file is one by the text of its beginning
    # Reads it, given where its photographs are; the views may be in any order
    models: Callable[[Path, Places], Models]
    # Reads its sparse points (N, 3); None where it has none
    points: Callable[[Path], np.ndarray] | None = None
    folders: tuple[str, ...] = (".",)  # of a capture, in which the program writes it
    up: str | None = None  # the axis that points up; None where the program does not define it
    # Names and folders of the program's meshes
    meshes: tuple[tuple[str, ...], tuple[str, ...]] = (MESH_STEMS, (".",))

    def find(self, path: Path) -> Path | None:
        """The camera file at a path or in a folder, None without one."""
        return camera_file(path, self.suffixes, self.known, self.folders)

    def places(self, file: Path, options: CaptureOptions) -> Places:
        """Where the photographs and meshes of a camera file are."""
        return Places.around(file, options, folders=self.folders)

    def read(self, file: Path, options: CaptureOptions) -> Rig:
        """Read the views with a pose of the largest model, by name."""
        places = self.places(file, options)
        with WellFormed(file):
            models, notes = self.models(file, places)
        views, several = largest_model(models, str(file))
        views = tuple(sorted(views, key=lambda view: view.name))
        return places.rig(self.NAME, views, self.up, places.mesh(*self.meshes), (*several, *notes))
