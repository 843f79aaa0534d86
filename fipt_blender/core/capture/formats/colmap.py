"""Reader for COLMAP models, binary and text, through pycolmap."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pycolmap

from ...run.documents import check_size, decoded, has_mark, read_limited
from ...run.errors import Problem, problem
from ..options import CaptureOptions
from ..places import IMAGE_FOLDERS, Places
from ..rig import Lens, Rig, damaged, find_mesh
from .colmap_sizes import MOST_BYTES, check_model
from .rig_files import camera_pose, stored_rotation

NAME = "colmap"
LOOKS_FOR = "cameras.bin or cameras.txt with images and points3D, in the folder or its sparse/0"
SURE_VIEWS = 5  # photographs in which a point was found
ENOUGH_POINTS = 500  # that so many saw, for the others to be left out
MODEL_FOLDERS = (".", "sparse/0", "sparse", "0", "dense/sparse", "dense/0/sparse", "colmap/sparse/0")
MESH_FOLDERS = (".", "dense", "dense/0")
MESH_STEMS = ("scene", "mesh", "meshed-poisson", "meshed-delaunay", "fused")


class Model(NamedTuple):
    """A capture's folder, and the folder of the model in it."""

    capture: Path
    folder: Path


def find(path: Path) -> Model | None:
    """The model in a capture's folder; of unconnected ones that with most images. None without one."""
    folder = next((path / name for name in MODEL_FOLDERS if _is_model(path / name)), None)
    if folder is None:
        return None
    if folder != path and _is_number(folder.name):
        # Of equally large models, the one with the lowest number.
        folder = max(sorted(_siblings(folder), key=lambda sibling: int(sibling.name)), key=_image_count)
    return Model(path, folder)


def read(found: Model, options: CaptureOptions) -> Rig:
    """Read all registered images of the model, in the order of their names.

    Photographs are searched in ``options.images`` and the usual folders beside the model, EXR files first
    (models are often solved on tone-mapped copies). COLMAP does not define an up axis. Of several unconnected
    models below the folder, the one with most images is read.
    """
    model = opened(found)
    try:
        images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: image.name)
        entries = [(image.name, model.cameras[image.camera_id], _camera_to_world(image)) for image in images]
    except (RuntimeError, ValueError, KeyError, IndexError, OSError) as error:
        raise damaged(found.folder, error) from None
    # Photographs of a model in dense/ are those that COLMAP has undistorted there.
    roots = tuple(reversed(_roots(found.capture, found.folder)))
    folders = (*IMAGE_FOLDERS, "dense/images")
    places = Places(found.folder, roots, options.images, folders, inside=found.capture)
    views = tuple(
        places.view(
            name,
            (int(camera.width), int(camera.height)),
            Lens(camera.model_name, tuple(float(value) for value in camera.params)),
            pose,
        )
        for name, camera, pose in entries
    )
    mesh = find_mesh([root / folder for root in reversed(roots) for folder in MESH_FOLDERS], MESH_STEMS)
    return places.rig(NAME, views, None, mesh, _notes(found.folder))


def points(found: Model) -> np.ndarray:
    """The sparse points (N, 3) of a model."""
    return _points(found)[0]


def sure_points(found: Model) -> np.ndarray:
    """Those of the points that many photographs see, if there are enough; they are off much less."""
    positions, views = _points(found)
    sure = views >= SURE_VIEWS
    return positions[sure] if sure.sum() >= ENOUGH_POINTS else positions


def opened(found: Model) -> pycolmap.Reconstruction:
    """A model as COLMAP has it in memory."""
    try:
        check_model(found.folder)
        with _plain(found.folder) as folder:
            model = pycolmap.Reconstruction(str(folder))
            if not (folder / "images.bin").is_file():
                for pose, _ in _entries((folder / "images.txt").read_text("utf-8")):
                    words = pose.split(maxsplit=9)  # COLMAP's own reader ends names at a blank
                    model.images[int(words[0])].name = words[9].rstrip()
        return model
    except (RuntimeError, ValueError, KeyError, IndexError, OSError) as error:
        raise damaged(found.folder, error) from None


@contextmanager
def _plain(folder: Path) -> Iterator[Path]:
    """The folder of a model, or a copy of a text model that COLMAP would read wrongly.

    That is one with byte-order marks, without points, or without the second lines of some images, which
    programs leave out that have no points.
    """
    files = [] if (folder / "images.bin").is_file() else sorted(folder.glob("*.txt"))
    texts = {file.name: decoded(read_limited(file, MOST_BYTES)) for file in files}
    lacks_lines = any(_is_pose(points) for _, points in _entries(texts.get("images.txt", "")))
    lacks_points = "images.txt" in texts and "points3D.txt" not in texts
    if not (lacks_lines or lacks_points or any(has_mark(file) for file in files)):
        yield folder
        return
    texts.setdefault("points3D.txt", "")
    if lacks_lines:
        entries: list[list[str]] = []
        for line in texts["images.txt"].splitlines():
            if _is_pose(line):
                entries.append([line, ""])
            elif entries and line.strip() and not line.startswith("#"):
                entries[-1][1] = line
        texts["images.txt"] = "".join(f"{pose}\n{points}\n" for pose, points in entries)
    with TemporaryDirectory(prefix="fipt-colmap-") as copy:
        for name, text in texts.items():
            (Path(copy) / name).write_bytes(text.encode())
        yield Path(copy)


def _entries(text: str) -> Iterator[tuple[str, str]]:
    """The two lines of each image of an images.txt, as COLMAP reads them."""
    lines = iter(text.splitlines())
    for line in lines:
        if line.strip() and not line.startswith("#"):
            yield line, next(lines, "")


def _is_pose(line: str) -> bool:
    """Whether a line of images.txt has an image's name behind its numbers, as those with points do not."""
    words = line.split(maxsplit=9)
    return len(words) == 10 and re.fullmatch(r"[-+.\d\seE]+", words[9]) is None


def _points(found: Model) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) of the model's points, and in how many photographs each was found (N,)."""
    stored = list(opened(found).points3D.values())
    views = np.array([point.track.length() for point in stored], np.int64)
    return np.array([point.xyz for point in stored], np.float64).reshape(-1, 3), views


def _is_model(folder: Path) -> bool:
    return any(
        (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file()
        for suffix in (".bin", ".txt")
    )


def _is_number(name: str) -> bool:
    """Whether a folder is named like COLMAP's models; "²" is a digit, too, but not a number."""
    return name.isascii() and name.isdigit()


def _siblings(folder: Path) -> list[Path]:
    """The numbered models of one reconstruction that COLMAP could not connect."""
    return [other for other in folder.parent.iterdir() if _is_number(other.name) and _is_model(other)]


def _image_count(folder: Path) -> int:
    """Number of images of a model, without reading all of it; 0 where it can't be read."""
    try:
        if (folder / "images.bin").is_file():
            with (folder / "images.bin").open("rb") as file:
                return int(struct.unpack("<Q", file.read(8))[0])
        check_size(folder / "images.txt", MOST_BYTES)
        with (folder / "images.txt").open("rb") as file:
            lines = (line for line in file if not line.startswith(b"#"))
            # Two lines per image: its pose, and its points, which may be an empty line.
            return sum(bool(line.strip()) for line in islice(lines, 0, None, 2))
    except (OSError, ValueError, struct.error):
        return 0


def _roots(path: Path, folder: Path) -> list[Path]:
    """Folders in which images and meshes are searched: the capture's folder, and the one above sparse/0."""
    roots = [path]
    folder = folder.absolute()
    if _is_number(folder.name):
        folder = folder.parent
    if folder.name == "sparse":
        folder = folder.parent
    if folder not in (path.absolute(), *roots):
        roots.append(folder)
    return roots


def _camera_to_world(image: pycolmap.Image) -> np.ndarray:
    """The pose (4, 4), with quaternions of any length: some programs do not normalize them."""
    stored = image.cam_from_world()
    x, y, z, w = stored.rotation.quat
    rotation = stored_rotation(np.array([w, x, y, z], np.float64))
    return camera_pose(rotation, -rotation.T @ stored.translation)


def _notes(folder: Path) -> tuple[Problem, ...]:
    """A warning where the solver left several unconnected models."""
    if not _is_number(folder.name):
        return ()
    others = [other for other in _siblings(folder) if other != folder]
    if not others:
        return ()
    sizes = ", ".join(f"{other} ({_image_count(other)})" for other in others)
    return (
        problem(
            "several-models.notes",
            number_of_others=len(others) + 1,
            name=folder.name,
            image_count=_image_count(folder),
            sizes=sizes,
        ),
    )
