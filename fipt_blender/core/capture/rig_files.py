# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera files of other programs: how they are recognized, read within limits, and what lies beside.

Camera files name photographs as they lay on another computer. No such path is followed out of the capture's
folders: photographs are found by their path within these folders, or by their file name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..alignment.turns import quaternion_rotation
from ..run.documents import read_limited
from ..run.errors import FiptError
from ..run.paths import leads_outside
from ..run.shapes import MOST_SIDE
from .images import read_size
from .options import CaptureOptions
from .rig import (
    PARTS_FOLDER,
    SEMANTICS_FOLDER,
    Lens,
    Note,
    RigView,
    WellFormed,
    damaged,
    find_ids,
    find_image,
    find_mesh,
    view_name,
)

IMAGE_FOLDERS = ("hdr", "exr", "images", "input", "Image", ".")
MESH_STEMS = ("scene", "mesh", "model", "texturedMesh", "scene_dense_mesh")
MOST_TEXT_BYTES = 256_000_000  # of a camera file


@dataclass(frozen=True)
class Places:
    """Where the photographs, id images and mesh of a camera file are searched.

    Attributes:
        roots: folders, the first ones first.
        images: the folder in which photographs are searched before all others, or None.
        image_folders: folders below each root that may hold photographs.
        found: what was found of each name, since camera files may repeat names without end.
    """

    roots: tuple[Path, ...]
    images: Path | None = None
    image_folders: tuple[str, ...] = IMAGE_FOLDERS
    found: dict[tuple[str, str], Any] = field(default_factory=dict, compare=False, repr=False)

    def _once(self, kind: str, name: str, find: Callable[[], Any]) -> Any:
        if (kind, name) not in self.found:
            self.found[kind, name] = find()
        return self.found[kind, name]

    @classmethod
    def around(
        cls, path: Path, options: CaptureOptions, image_folders: tuple[str, ...] = IMAGE_FOLDERS
    ) -> Places:
        """The places around a camera file: its folder and the one above."""
        return cls((path.parent, path.absolute().parent.parent), options.images, image_folders)

    def image(self, name: str) -> Path:
        """The photograph of a name or path; the path that it should have where it does not exist."""
        path: Path = self._once("image", name, lambda: self._image(name))
        return path

    def _image(self, name: str) -> Path:
        names = _inner_names(name)
        usual = [root / folder for root in self.roots for folder in self.image_folders]
        searched = [folders for folders in ([self.images] if self.images else [], usual) if folders]
        paths = [find_image(folders, inner) for folders in searched for inner in names]
        return next((path for path in paths if path.is_file()), paths[0])

    def size(self, name: str) -> tuple[int, int]:
        """Width and height in pixels of the photograph of a name.

        Raises:
            FiptError: ``image-missing`` or ``image-unreadable``.
        """
        size: tuple[int, int] = self._once("size", name, lambda: read_size(self.image(name)))
        return size

    def view(self, name: str, size: tuple[int, int], lens: Lens, camera_to_world: np.ndarray) -> RigView:
        """The view of a photograph, with the id images that exist.

        Args:
            name: of the photograph, as the camera file has it.
            size: width and height in pixels that the lens is calibrated for.
            lens, camera_to_world: see `RigView`.
        """
        stem = view_name(_inner_names(name)[0])
        ids = {
            kind: self._once(kind, stem, partial(self._ids, kind, stem))
            for kind in (PARTS_FOLDER, SEMANTICS_FOLDER)
        }
        return RigView(
            name=stem,
            split=None,
            image=self.image(name),
            width=size[0],
            height=size[1],
            lens=lens,
            camera_to_world=camera_to_world,
            parts=ids[PARTS_FOLDER],
            semantics=ids[SEMANTICS_FOLDER],
        )

    def _ids(self, kind: str, stem: str) -> Path | None:
        return next(filter(None, (find_ids(root / kind, stem) for root in self.roots)), None)

    def mesh(self, stems: Sequence[str] = MESH_STEMS, folders: Sequence[str] = (".",)) -> Path | None:
        """The first mesh with one of these names, or None."""
        return find_mesh([root / folder for root in self.roots for folder in folders], stems)


def photograph(file: Path, name: str, options: CaptureOptions) -> Path:
    """The photograph that a camera file names by its path, below the file's folder or the user's folder.

    Raises:
        FiptError: ``path-outside`` for a path that leads elsewhere, if its name is not found here either.
    """
    folders = [folder for folder in (options.images, file.parent) if folder]
    if _follows(file, name, options):
        return find_image(folders, name)
    inner = name.replace("\\", "/").replace("\0", "").rpartition("/")[2]
    image = find_image(folders, inner) if inner not in ("", "..") else folders[0]
    if not image.is_file():
        refuse_outside(file, name, options)
    return image


def refuse_outside(file: Path, name: str, options: CaptureOptions) -> None:
    """Refuse a path in a camera file that leads out of the file's folder.

    Raises:
        FiptError: ``path-outside``.
    """
    if not _follows(file, name, options):
        raise FiptError(
            "path-outside",
            f"{file} names the file {name[:200]!r}, which is outside of the capture's folder.",
            "Move the files into the capture, or choose the folder of the photographs (Photographs in"
            " the import settings, --images).",
        )


def _follows(file: Path, name: str, options: CaptureOptions) -> bool:
    return options.own_paths or not leads_outside(file.parent, name)


def _inner_names(name: str) -> list[str]:
    """A photograph's path within the capture, without what leads out of it, and its file name."""
    path = PurePosixPath(name.replace("\\", "/"))
    parts = [part for part in path.parts if part != "."]
    if not parts or parts[-1] in ("..", "/"):
        return ["unnamed"]
    leads_out = path.is_absolute() or ".." in parts or ":" in parts[0]
    return list(dict.fromkeys([parts[-1] if leads_out else "/".join(parts), parts[-1]]))


# ------------------------------------------------------------------------------------------------ recognition


def head(path: Path) -> str:
    """The beginning of a file as text, for recognizing its format; empty where it can't be read."""
    try:
        with path.open("rb") as file:
            return file.read(1 << 16).decode("utf-8", errors="replace")
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
            for entry in sorted((path / folder).iterdir()):
                if entry.suffix.lower() in wanted and entry.is_file():
                    yield entry


def camera_file(
    path: Path, suffixes: Iterable[str], known: Callable[[str], bool], folders: Sequence[str] = (".",)
) -> Path | None:
    """The first of these files whose beginning is known, None without one."""
    return next((file for file in camera_files(path, suffixes, folders) if known(head(file))), None)


# ---------------------------------------------------------------------------------------------------- reading


def read_text_rig(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """The text of a camera file.

    Raises:
        FiptError: ``rig-damaged`` where it is not a file, not UTF-8, or too large.
    """
    if not path.is_file():
        raise damaged(path, "it contains no camera file")
    with WellFormed(path):
        return read_limited(path, most_bytes).decode("utf-8-sig").replace("\r\n", "\n")


def read_xml_rig(path: Path) -> ElementTree.Element:
    """The root element of an XML file without a document type, whose entities could expand without end.

    Raises:
        FiptError: ``rig-damaged``.
    """
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


def largest_model(
    models: Sequence[Sequence[RigView]], source: str
) -> tuple[tuple[RigView, ...], tuple[Note, ...]]:
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
    note = Note(
        "several-models",
        f"{source} holds {len(filled)} unconnected models ({sizes} photographs); only the largest is used.",
        "To use another one, or all of them together, connect them in the program that solved the cameras.",
    )
    return tuple(chosen), (note,)
