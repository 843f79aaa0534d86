"""Readers of data sets: the FIPT authors' synthetic and real captures, and the DSLR photographs of ScanNet++.

The synthetic ones and ScanNet++ are files transforms.json with axes of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...conventions import transform_poses
from ...run.errors import FiptError
from ..files import name_parts, stem_of, suffix_of
from ..options import CaptureOptions
from ..places import Places
from ..rig import (
    PARTS_FOLDER,
    SEMANTICS_FOLDER,
    Lens,
    Rig,
    RigView,
    WellFormed,
    damaged,
    find_mesh,
    read_json_rig,
)
from .rig_files import read_text_rig
from .transforms import Frame, Side, Transforms, frame_view


@dataclass(frozen=True)
class DataSet:
    """A format of `registry`."""

    NAME: str
    LOOKS_FOR: str
    find: Callable[[Path], Path | None]
    read: Callable[[Path, CaptureOptions], Rig]


_FIPT_IDS = {PARTS_FOLDER: "IndexMA", SEMANTICS_FOLDER: "segmentation"}
_FIPT_SPLITS = {"train": "train", "val": "held_back"}
# Cameras of the synthetic captures have the axes X left, Y up, Z forward; those of transforms.json OpenGL's.
_OPENGL_FROM_FIPT = np.diag([-1.0, 1.0, -1.0, 1.0])
_SCANNETPP = ("dslr/nerfstudio/transforms.json", "nerfstudio/transforms.json")
_SCANNETPP_MASKS = "resized_anon_masks"
# The ScanNet++ toolbox swaps X and Y and negates Z of the poses without saying so in the file. The laser
# scan's mesh keeps the axes of the solve; here the poses get them again.
_SOLVE_FROM_STORED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])


# ------------------------------------------------------------------------------------------ FIPT, synthetic


@dataclass(frozen=True, kw_only=True)
class _SplitFrame(Frame):
    file_path: str = ""


@dataclass(frozen=True, kw_only=True)
class _Split(Transforms):
    frames: tuple[_SplitFrame, ...]
    width: Side | None = None
    height: Side | None = None


@dataclass(frozen=True, kw_only=True)
class _Scene(Transforms):
    test_frames: tuple[Frame, ...] = ()
    has_mask: bool = True


def _find_synthetic(path: Path) -> Path | None:
    """The folder of this layout, of which a path may be a split or its camera file; None without one.

    Other readers assume other camera axes.
    """
    split = path.parent if path.name == "transforms.json" else path
    root = split.parent if split.name in _FIPT_SPLITS and (split / "Image").is_dir() else path
    train = root / "train"
    return root if (train / "transforms.json").is_file() and (train / "Image").is_dir() else None


def _read_synthetic(path: Path, options: CaptureOptions) -> Rig:
    """Read the splits train and, where present, val (held back).

    The views of a split share one horizontal field of view, and the principal point is centred. The world is
    Y up unless the JSON has another "up_axis". IndexMA/ contains part ids, segmentation/ semantic ids.
    """
    rigs: list[Rig] = []
    up_axis = "y"
    for folder, split in _FIPT_SPLITS.items():
        file = path / folder / "transforms.json"
        if not file.is_file():
            continue
        data = read_json_rig(file, _Split)
        data, up_axis = replace(data, w=data.width, h=data.height), data.up_axis or up_axis
        inside = (path / folder,)
        places = Places(file, inside, image_folders=(".", "Image"), relative=True, id_folders=_FIPT_IDS)
        frames = [data.whole(frame) for frame in data.frames]
        views = [_synthetic_view(places, split, *each) for each in enumerate(frames)]
        rigs.append(places.rig("fipt-synthetic", views, up_axis, None))
    every = tuple(view for rig in rigs for view in rig.views)
    notes = tuple(note for rig in rigs for note in rig.notes)
    return Rig("fipt-synthetic", every, up_axis, find_mesh([path], ["scene", "mesh"]), notes)


def _synthetic_view(places: Places, split: str, index: int, frame: Frame) -> RigView:
    """The view of the frame's file_path where it names an image, else of the authors' name by its index."""
    name = f"{index:03d}_0001.exr"
    if frame.file_path and (suffix_of(frame.file_path) or places.find(frame.file_path)):
        name = frame.file_path
    number = stem_of(name_parts(name)[-1]).removesuffix("_0001")
    frame = replace(frame, file_path=name, name=f"{places.file.parent.name}/{number}")
    view = frame_view(places.file, frame, split, places)
    return replace(view, camera_to_world=view.camera_to_world @ _OPENGL_FROM_FIPT)


# ----------------------------------------------------------------------------------------------- FIPT, real


def _find_real(path: Path) -> Path | None:
    """The folder, None if it has another layout."""
    return path if (path / "cam.txt").is_file() and (path / "K_list.txt").is_file() else None


def _read_real(path: Path, options: CaptureOptions) -> Rig:
    """Read all views; the layout defines neither splits nor an up axis.

    Both text files begin with the number of views, followed by three lines of three numbers for each view:
    origin, look-at point and up vector in cam.txt, the camera matrix in K_list.txt.
    """
    poses = _read_blocks(path / "cam.txt")
    matrices = _read_blocks(path / "K_list.txt")
    if len(poses) != len(matrices):
        raise damaged(path / "K_list.txt", f"{len(matrices)} camera matrices for {len(poses)} poses")
    places = Places(path / "cam.txt", (path,), options.images, ("Image",), id_folders=_FIPT_IDS)
    views = []
    for index, (pose, matrix) in enumerate(zip(poses, matrices, strict=True)):
        name = f"{index:03d}_0001.exr"
        size = places.size(name)
        lens = _real_lens(path / "K_list.txt", index, matrix, *size)
        pose = _look_at(path / "cam.txt", index, pose)
        views.append(places.view(name, size, lens, pose, called=f"{index:03d}"))
    return places.rig("fipt-real", views, None, places.mesh(("scene", "mesh")))


def _read_blocks(path: Path) -> np.ndarray:
    """(N, 3, 3) numbers of a file that contains N and 3 N lines."""
    with WellFormed(path):
        words = read_text_rig(path).split()
        count = int(words[0])
        values = np.array(words[1:], np.float64)
    if values.size != count * 9:
        raise damaged(path, f"{values.size} numbers instead of 9 for each of {count} views")
    return values.reshape(count, 3, 3)


def _look_at(path: Path, index: int, rows: np.ndarray) -> np.ndarray:
    """Camera-to-world (4, 4), OpenCV axes, from origin, look-at point and up vector."""
    origin, target, up = rows
    lengths = np.linalg.norm(target - origin), np.linalg.norm(up)
    if not (np.isfinite(rows).all() and min(lengths) > 0.0):
        raise damaged(path, f"view {index} has no viewing direction")
    forward = (target - origin) / lengths[0]
    up = up / lengths[1]
    # cam.txt has few digits.
    if abs(forward @ up) > 1e-2:
        raise FiptError("pose-not-rotation.look-at", index=index, path=path)
    down = -(up - (up @ forward) * forward)
    down /= np.linalg.norm(down)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    pose[:3, 3] = origin
    return pose


def _real_lens(path: Path, index: int, matrix: np.ndarray, width: int, height: int) -> Lens:
    if not np.isfinite(matrix).all() or abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise damaged(path, f"the camera matrix of view {index} has skew or is not finite")
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    # The format has no image size; a principal point far from the centre indicates another size.
    if abs(cx / width - 0.5) > 0.25 or abs(cy / height - 0.5) > 0.25:
        raise FiptError("image-size", index=index, width=width, height=height, cx=cx, cy=cy)
    return Lens("PINHOLE", (fx, fy, cx, cy))


# ------------------------------------------------------------------------------------------------ ScanNet++


def _find_scannetpp(path: Path) -> Path | None:
    """The camera file of a scene, of its folder dslr, or at a path, None without one."""
    files = [path] if path.is_file() else [path / name for name in _SCANNETPP]
    known = (file for file in files if file.parts[-2:] == ("nerfstudio", "transforms.json"))
    return next(filter(Path.is_file, known), None)


def _read_scannetpp(file: Path, options: CaptureOptions) -> Rig:
    """Read all frames except those marked as bad; test frames are held back.

    The mesh is the laser scan's. ScanNet++ does not define an up axis.
    """
    scene = read_json_rig(file, _Scene)
    dslr = file.parent.parent
    image_folders = ("hdr", "resized_images", "original_images", ".")
    places = Places(file, (dslr,), options.images, image_folders, (_SCANNETPP_MASKS,))
    views = []
    for frames, split in ((scene.frames, None), (scene.test_frames, "held_back")):
        for frame in (scene.whole(frame) for frame in frames if not frame.is_bad):
            frame = frame if scene.has_mask else replace(frame, mask_path=None)
            view = frame_view(file, frame, split, places)
            pose = transform_poses(_SOLVE_FROM_STORED, view.camera_to_world)
            views.append(replace(view, camera_to_world=pose))
    mesh = find_mesh([dslr.parent / "scans", dslr.parent], ("mesh_aligned_0.05", "mesh"))
    return places.rig("scannetpp", views, None, mesh)


SETS = (
    DataSet("fipt-synthetic", "train/transforms.json beside train/Image/", _find_synthetic, _read_synthetic),
    DataSet("fipt-real", "cam.txt and K_list.txt", _find_real, _read_real),
    DataSet("scannetpp", _SCANNETPP[0], _find_scannetpp, _read_scannetpp),
)
