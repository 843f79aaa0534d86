"""Readers for scans: photographs and depth images with one pose for both, of apps and of data sets.

Each is a `ScanApp`: how its folder is found, and what it says of its frames. Sources: Polycam's polyform;
Record3D's .r3d; exports of 3D Scanner App (Laan Labs); the documentation of Stray Scanner; 7-Scenes,
tsdf-fusion and ScanNet's exporter.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...conventions import opengl_to_opencv_camera, transform_poses
from ...run.documents import decoded, read_limited
from ...run.errors import FiptError, Problem, problem
from ...run.kinds import Row
from ..depth_images import depth_size, registered_depths
from ..files import role, stem_of, visible
from ..options import CaptureOptions
from ..places import IMAGE_FOLDERS, MESH_STEMS, Places
from ..rig import Lens, Rig, WellFormed, damaged, read_json_rig, read_pose
from .rig_files import (
    MOST_TEXT_BYTES,
    camera_files,
    camera_pose,
    head,
    number,
    numbers,
    pixel_size,
    read_text_rig,
    similarity,
    stored_rotation,
)

# Polycam's cameras and photographs; the corrected ones are missing where it could not improve its tracking.
_POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_POLYCAM_POSE = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]
_RECORD3D = ("metadata.json", "metadata", "EXR_RGBD/metadata.json")
_POSE = ".pose.txt"
MOST_POSE_BYTES = 10_000  # of a file of one frame
_STRAY = ("odometry.csv", "camera_matrix.csv")


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame of a scan."""

    name: str  # of its photograph
    pose: np.ndarray  # (4, 4) camera to world, OpenCV axes
    # Fx, fy, cx, cy in pixels of the photograph; None for the field of view of the depth image
    intrinsics: tuple[float, ...] | None
    size: tuple[int, int] | None = None  # width and height of the photograph, None for those of the file
    depth: str = ""  # name of its depth image; "" for the photograph's
    called: str = ""  # the view's name; "" for the photograph's
    time: float = 0.0  # seconds, in which pictures may be called


@dataclass(frozen=True, eq=False)
class _Scan:
    """What an app's folder holds."""

    places: Places  # where the photographs are
    depths: Path  # folder of the depth images
    frames: Sequence[_Frame]  # of the scan
    without: str | None = None  # what to do if no frame has a photograph; None where each must have one
    # Fx, fy, cx, cy in pixels of the depth images; None for the photographs'
    depth_camera: tuple[float, ...] | None = None
    lost: int = 0  # how many frames have no pose
    numbered: bool = False  # whether frames are called by numbers, in folders of nothing else
    video: bool = False  # whether photographs are pictures of a video, which another program has numbered


def _paired(scan: _Scan) -> _Scan:
    """The scan with frames that name their files, where these are called by other numbers or by times."""
    if not scan.numbered:
        return scan
    places, names = scan.places, [frame.name for frame in scan.frames]
    expected = [*([places.images] if places.images else []),
                *(root / name for root in places.roots for name in places.image_folders)]  # fmt: skip
    folder = next((each for each in expected if places.folders.images(each)), None)
    colors = [] if folder is None else [path for path in places.folders.images(folder) if not role(path.name)]
    colored = _by_number(names, colors)
    if scan.video and colors:
        colored = _by_time(scan.frames, colors) or _of_video(names, colors, places.file)
    deep = _by_number(
        [frame.depth or frame.name for frame in scan.frames], places.folders.images(scan.depths)
    )
    frames = [
        replace(frame, name=colored.get(index, frame.name), depth=deep.get(index, frame.depth or frame.name))
        for index, frame in enumerate(scan.frames)
    ]
    return replace(scan, frames=frames)


def _number(name: str) -> int | None:
    """The number that a file or frame is called by, with a word before it or not; None without."""
    found = re.fullmatch(r"\D*(\d{1,18})", stem_of(name))
    return None if found is None else int(found[1])


def _by_number(names: Sequence[str], files: Sequence[Path]) -> dict[int, str]:
    """The file of each frame, by its index, whose number has the same value: 0.jpg is 000000.png."""
    numbers = Counter(_number(file.name) for file in files)
    known = {number: file.name for file in files if numbers[number := _number(file.name)] == 1}
    return {index: known[number] for index, name in enumerate(names)
            if (number := _number(name)) is not None and number in known}  # fmt: skip


def _by_time(frames: Sequence[_Frame], files: Sequence[Path]) -> dict[int, str]:
    """The pictures that are called by the times of their frames, as far as half of a frame's time."""
    times = np.array([frame.time for frame in frames])
    stems = [stem_of(file.name) for file in files]
    if len(times) < 2 or not all(re.fullmatch(r"\d+\.\d+", stem) for stem in stems):
        return {}
    apart = np.abs(times[:, None] - [float(stem) for stem in stems])
    pairs = {int(index): column for column, index in enumerate(apart.argmin(axis=0))}
    most = 0.5 * float(np.median(np.diff(times)))
    return {index: files[column].name for index, column in pairs.items() if apart[index, column] <= most}


def _of_video(names: Sequence[str], files: Sequence[Path], table: Path) -> dict[int, str]:
    """The pictures of a video's frames. Programs number what they extract from 0 or 1 on."""
    asked = [number for name in names if (number := _number(name)) is not None]
    given = [number for file in files if (number := _number(file.name)) is not None]
    if len(asked) < len(names) or len(given) < len(files):
        return {}
    wanted, found = sorted(asked), sorted(given)
    if len(set(found)) == len(found) == len(wanted) and found != wanted:
        order = sorted(files, key=lambda file: _number(file.name) or 0)
        return {asked.index(number): file.name for number, file in zip(wanted, order, strict=True)}
    renumbered = found == list(range(found[0], found[0] + len(found))) and found[0] in (0, 1)
    gaps = wanted != list(range(wanted[0], wanted[0] + len(wanted)))
    if renumbered and found != wanted and not (gaps and set(wanted) <= set(found)):
        raise FiptError("pairs-unsure", pictures=len(files), folder=files[0].parent, first=found[0],
                        last=found[-1], table=table, frames=len(wanted))  # fmt: skip
    return _by_number(names, files)


@dataclass(frozen=True)
class ScanApp:
    """A format of `registry`; the world is Y up unless `UP` says that it must be found."""

    NAME: str
    LOOKS_FOR: str
    find: Callable[[Path], Any]
    scan: Callable[[Any, CaptureOptions], _Scan]
    MESHES: tuple[str, ...] = MESH_STEMS
    UP: str | None = "y"

    def read(self, found: Any, options: CaptureOptions) -> Rig:
        """Read the frames with a photograph, and all depth images."""
        scan = _paired(self.scan(found, options))
        places, shown = scan.places, next((each for each in scan.frames if scan.places.find(each.name)), None)
        if scan.without is not None and shown is None:
            raise FiptError("image-missing.read", file=places.file, without=scan.without)
        images = [places.depth(scan.depths, frame.depth or frame.name) for frame in scan.frames]
        if scan.depth_camera and not any(images):
            raise FiptError("depth-empty.unpaired", frames=len(scan.frames), folder=scan.depths)
        whole = depth_size(next(filter(None, images))) if scan.depth_camera else (1, 1)
        views = []
        for frame in scan.frames:
            optional = shown is not None and scan.without is not None and not places.find(frame.name)
            size = frame.size or places.size(shown.name if shown and optional else frame.name)
            wider, higher = size[0] / whole[0], size[1] / whole[1]
            fx, fy, cx, cy = scan.depth_camera or (0.0,) * 4
            lens = Lens("PINHOLE", frame.intrinsics or (fx * wider, fy * higher, cx * wider, cy * higher))
            views.append(places.view(frame.name, size, lens, frame.pose, called=frame.called))
        depths = registered_depths(views, images, options.depth_unit)
        if scan.depth_camera is not None:
            fx, fy, cx, cy = scan.depth_camera
            width, height = whole
            depths = tuple(
                replace(depth, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy) for depth in depths
            )
        notes: list[Problem] = []
        files = places.folders.images(scan.depths) if scan.numbered else []
        unused, lacking = len(set(files) - set(images)) - scan.lost, images.count(None)
        if files and (unused > 0 or lacking):
            notes.append(
                problem("depths-unpaired", unused=max(unused, 0), folder=scan.depths, lacking=lacking)
            )
        if not depths and any(places.file.parent.glob("rgbd/*.depth")):
            text = f"The depth images beside {places.file} are compressed as in Record3D's .r3d: not read."
            remedy = "Export EXR + RGBD from Record3D, or give a mesh (--mesh)."
            notes.append(Problem("depth-format", text, remedy))
        if scan.lost:
            text = f"{scan.lost} of {scan.lost + len(scan.frames)} frames have no pose, since the tracking"
            remedy = "Nothing needs to be done."
            notes.append(problem("pose-lost.read", text=text, remedy=remedy))
        if scan.without is not None:
            views = [view for view in views if not view.missing]
        one_camera = scan.depth_camera is not None and scan.frames[0].intrinsics is None
        mesh = places.mesh(self.MESHES)
        return places.rig(self.NAME, views, self.UP, mesh, notes, depths, one_camera)


# ---------------------------------------------------------------------------------------------------- Polycam


@dataclass(frozen=True)
class _MeshInfo:
    alignmentTransform: tuple[float, ...] | None = None


def _find_polycam(path: Path) -> tuple[Path, str] | None:
    """The folder of the cameras, and the name of that of their photographs; None without."""
    for root in (path / "keyframes", path):
        for cameras, photographs in _POLYCAM:
            folder = root / cameras
            if folder.is_dir() and any(file.suffix.lower() == ".json" for file in visible(folder)):
                return folder, photographs
    return None


def _polycam(found: tuple[Path, str], options: CaptureOptions) -> _Scan:
    """Raw data, in the coordinates of its mesh raw.glb, to which mesh_info.json leads by columns."""
    cameras, photographs = found
    root = cameras.parent.parent
    folders = tuple(f"keyframes/{name}" for name in (photographs, "hdr", "exr"))
    places = Places(cameras, (root,), options.images, (*folders, "hdr", "exr", "."))
    alignment, frames = _alignment(root / "mesh_info.json"), []
    for file in visible(cameras):
        if file.suffix.lower() == ".json":
            data = read_json_rig(file, dict)
            with WellFormed(file):
                pose = read_pose(file, [[number(data[key]) for key in row] for row in _POLYCAM_POSE])
                has_size = "width" in data and "height" in data  # missing since 2025
                size = pixel_size(data["width"], data["height"]) if has_size else None
                intrinsics = tuple(number(data[key]) for key in ("fx", "fy", "cx", "cy"))
            pose = transform_poses(alignment, opengl_to_opencv_camera(pose))
            frames.append(_Frame(file.stem, pose, intrinsics, size))
    return _Scan(places, cameras.parent / "depth", frames)


def _alignment(file: Path) -> np.ndarray:
    """Similarity (4, 4) from the cameras' world to the mesh; the identity where the file does not have it."""
    stored = read_json_rig(file, _MeshInfo).alignmentTransform if file.is_file() else None
    if stored is None:
        return np.eye(4)
    with WellFormed(file):
        matrix = np.array(stored).reshape(4, 4).T
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        return similarity(scale, matrix[:3, :3] / (scale or 1.0), matrix[:3, 3])


# --------------------------------------------------------------------------------------------------- Record3D


@dataclass(frozen=True)
class _Metadata:
    """Fields as the file names them; a pose is a quaternion x, y, z, w and a position, with OpenGL's axes."""

    poses: tuple[tuple[float, float, float, float, float, float, float], ...]
    K: tuple[float, ...]
    w: float
    h: float
    perFrameIntrinsicCoeffs: tuple[Row, ...] | None = None


def _find_record3d(path: Path) -> Path | None:
    """The metadata, None without; its keys may be anywhere, so that all of a file is searched."""
    for file in [path] if path.is_file() else [path / name for name in _RECORD3D]:
        if file.is_file() and file.name.startswith("metadata"):
            try:
                text = decoded(read_limited(file, MOST_TEXT_BYTES))
            except ValueError:
                continue
            if '"poses"' in text and '"K"' in text:
                return file
    return None


def _record3d(file: Path, options: CaptureOptions) -> _Scan:
    data = read_json_rig(file, _Metadata)
    # Zero in one of two orders of storing the matrix, the principal point in the other.
    with WellFormed(file):
        fx, _, cx, _, fy, cy, column_cx, column_cy, _ = data.K
        size = pixel_size(data.w, data.h)
    intrinsics = data.perFrameIntrinsicCoeffs or [(fx, fy, cx + column_cx, cy + column_cy)] * len(data.poses)
    if len(intrinsics) != len(data.poses):
        raise damaged(file, f"it has {len(data.poses)} poses, but intrinsics of {len(intrinsics)} frames")
    frames = []
    with WellFormed(file):
        for index, (values, coefficients) in enumerate(zip(data.poses, intrinsics, strict=True)):
            pose = opengl_to_opencv_camera(_posed((values[3], *values[:3]), values[4:]))
            frames.append(_Frame(str(index), pose, coefficients, size))
    places = Places.around(file, options, ("rgb", "rgbd", *IMAGE_FOLDERS))
    return _Scan(places, file.parent / "depth", frames, numbered=True, video=True)


def _posed(wxyz: Sequence[float], centre: Sequence[float]) -> np.ndarray:
    """Pose (4, 4) of a quaternion from camera to world and a position."""
    return camera_pose(stored_rotation(np.array(wxyz, np.float64)).T, np.array(centre, np.float64))


# --------------------------------------------------------------------------------------------- 3D Scanner App


@dataclass(frozen=True)
class _Arkit:
    """Fields as the file names them: camera to world and the camera matrix, by rows, with OpenGL's axes."""

    cameraPoseARFrame: tuple[float, ...]
    intrinsics: tuple[float, ...]


def _scanner_files(path: Path) -> list[Path]:
    return [file for file in camera_files(path, (".json",)) if file.name.startswith("frame_")]


def _find_scanner_app(path: Path) -> Path | None:
    """The folder of the frames, or None; one frame tells."""
    known = any('"cameraPoseARFrame"' in head(file) for file in _scanner_files(path)[:1])
    return (path.parent if path.is_file() else path) if known else None


def _scanner_app(folder: Path, options: CaptureOptions) -> _Scan:
    """The export *All Data*; most frames have a depth image without a photograph."""
    files, frames = _scanner_files(folder), []
    for file in files:
        data = read_json_rig(file, _Arkit)
        with WellFormed(file):
            pose = np.array(data.cameraPoseARFrame, np.float64).reshape(4, 4)
            fx, _, cx, _, fy, cy, *_ = np.array(data.intrinsics, np.float64).reshape(9).tolist()
        depth = file.stem.replace("frame_", "depth_")
        frames.append(_Frame(file.stem, opengl_to_opencv_camera(pose), (fx, fy, cx, cy), None, depth))
    places = Places.around(files[0], options)
    return _Scan(places, folder, frames, "Export All Data with its photographs from 3D Scanner App.")


# ---------------------------------------------------------------------------------------------- Stray Scanner


def _find_stray(path: Path) -> Path | None:
    """The folder of the odometry, or None."""
    folder = path if path.is_dir() else path.parent
    return folder if all((folder / name).is_file() for name in _STRAY) else None


def _stray(folder: Path, options: CaptureOptions) -> _Scan:
    """Poses with OpenCV's axes, depth images, and the camera matrix of a video, whose pictures are in rgb."""
    file = folder / _STRAY[0]
    with WellFormed(file):
        text = read_text_rig(folder / _STRAY[1]).replace(",", " ")
        fx, _, cx, _, fy, cy, *_ = numbers(text, 9).tolist()
        frames = []
        for row in csv.DictReader(read_text_rig(file).splitlines(), skipinitialspace=True):
            values = [number(row[name]) for name in ("qw", "qx", "qy", "qz", "x", "y", "z")]
            pose, lens = _posed(values[:4], values[4:]), (fx, fy, cx, cy)
            frames.append(_Frame(row["frame"].strip(), pose, lens, time=number(row["timestamp"])))
    extract = (
        "Make a folder rgb there, and extract the video:"
        " ffmpeg -i rgb.mp4 -fps_mode passthrough -start_number 0 rgb/%06d.jpg"
    )
    places = Places(file, (folder,), options.images, ("rgb", "images", "."))
    return _Scan(places, folder / "depth", frames, extract, numbered=True, video=True)


# ------------------------------------------------------------------ 7-Scenes, tsdf-fusion, ScanNet's exporter


def _find_rgbd(path: Path) -> Path | None:
    """The folder itself or its folder data, if it has one of the layouts, else None."""
    for root in (path, path / "data"):
        if not root.is_dir():
            continue
        if all((root / name).is_dir() for name in ("depth", "pose", "intrinsic")):
            return root
        names = [file.name.lower() for file in visible(root)]
        if all(any(name.endswith(end) for name in names) for end in (_POSE, ".depth.png")):
            return root
    return None


def _rgbd(root: Path, options: CaptureOptions) -> _Scan:
    """frame-000000.color.jpg, .depth.png, .pose.txt, or folders color, depth, pose and intrinsic.

    Poses are camera to world with OpenCV axes, in metres, and infinity or NaN where the tracking was lost.
    """
    color, places = None, Places(root, (root,), options.images, ("color", "."))
    if (root / "intrinsic").is_dir():
        depth_file, color_file = (root / "intrinsic" / f"intrinsic_{kind}.txt" for kind in ("depth", "color"))
        color = _camera_matrix(color_file) if color_file.is_file() else None
        files = [file for file in visible(root / "pose") if file.suffix.lower() == ".txt"]
        files.sort(key=lambda file: (len(file.stem), file.stem))  # numbered without leading zeros
        named = [(file.stem, file.stem, file.stem) for file in files]
    else:
        depth_file = root / "camera-intrinsics.txt"
        files = [file for file in visible(root) if file.name.lower().endswith(_POSE)]
        stems = [file.name[: -len(_POSE)] for file in files]
        named = [(stem, f"{stem}.color", f"{stem}.depth") for stem in stems]
    frames = []
    for file, (stem, photograph, depth) in zip(files, named, strict=True):
        words = read_text_rig(file, MOST_POSE_BYTES).split()
        with WellFormed(file):
            pose = np.array([float(word) for word in words], np.float64).reshape(4, 4)
        places.find(photograph)  # those of lost frames are told of here, and not as ones without a camera
        if np.isfinite(pose).all():
            frames.append(_Frame(photograph, pose, color, None, depth, stem))
    folder = root / "depth" if (root / "intrinsic").is_dir() else root
    lost, camera = len(files) - len(frames), _camera_matrix(depth_file)
    numbered = folder != root
    return _Scan(places, folder, frames, "Add the photographs of the frames.", camera, lost, numbered)


def _camera_matrix(path: Path) -> tuple[float, ...]:
    if not path.is_file():
        raise FiptError("intrinsics-missing.camera-matrix", path=path)
    text = read_text_rig(path, MOST_POSE_BYTES)
    side = 4 if len(text.split()) == 16 else 3
    with WellFormed(path):
        matrix = numbers(text, side * side).reshape(side, side)
    return tuple(float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))


_KEYFRAMES = "keyframes/corrected_cameras or keyframes/cameras with JSON files"
_FRAMES = "frame-*.depth.png, frame-*.pose.txt and camera-intrinsics.txt, or folders depth, pose, color"
APPS = (
    ScanApp("polycam", _KEYFRAMES, _find_polycam, _polycam, ("raw", "mesh", "scene")),
    ScanApp("record3d", "metadata.json (or metadata) with poses, K, w and h", _find_record3d, _record3d),
    ScanApp(
        "3d-scanner-app",
        "frame_00000.json with cameraPoseARFrame and intrinsics",
        _find_scanner_app,
        _scanner_app,
        ("export", "textured_output", *MESH_STEMS),
    ),
    ScanApp("stray-scanner", " and ".join(_STRAY), _find_stray, _stray, UP=None),
    ScanApp("rgbd", _FRAMES, _find_rgbd, _rgbd, UP=None),
)
