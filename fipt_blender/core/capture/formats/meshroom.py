# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for Meshroom's cameras: the .sfm and .json files of StructureFromMotion and ConvertSfMFormat.

Source: AliceVision's sfmDataIO. Matrices are stored column by column, so that a rotation read row by row
leads from the camera to the world. Meshes are written with Y and Z negated, which the poses follow here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import Lens, Rig, RigView, WellFormed, find_mesh, read_json_rig
from .radial import distorting_lens
from .rig_files import camera_file, number, numbers, pixel_size

NAME = "meshroom"
LOOKS_FOR = "an .sfm or .json file with version, views, intrinsics and poses"
_MESH_FROM_SFM = np.diag([1.0, -1.0, -1.0, 1.0])
# Names before version 1.2.8, which had the distortion in the camera's type.
_OLD_TYPES = {
    "pinhole": "none",
    "radial1": "radialk1",
    "radial3": "radialk3",
    "brown": "brown",
    "fisheye4": "fisheye",
    "fisheye1": "fisheye1",
}
_COUNTS = {"none": 0, "radialk1": 1, "radialk3": 3, "brown": 5, "fisheye": 4, "fisheye1": 1}


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    keys = ('"version"', '"views"', '"viewId"')
    found = camera_file(path, (".sfm", ".json"), lambda text: all(key in text for key in keys))
    nodes = (path if path.is_dir() else path.parent).glob("MeshroomCache/StructureFromMotion/*")
    # Of a project's several nodes the one that was computed last.
    return found or max((file for node in nodes if (file := find(node))), key=_time, default=None)


def _time(file: Path) -> float:
    return file.stat().st_mtime


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all views with a pose, those of rigs included. The world is Y up, as in Meshroom's viewer.

    Raises:
        FiptError: ``rig-damaged`` or ``camera-model``.
    """
    data = read_json_rig(file, dict)
    places = Places.around(file, options)
    project = next((folder.parent for folder in file.parents if folder.name == "MeshroomCache"), None)
    if project is not None:
        places = Places(file, (project,), options.images, inside=project)
    with WellFormed(file):
        version = tuple(int(value) for value in numbers(data["version"], 3))
        lenses = {str(entry["intrinsicId"]): _lens(file, entry, version) for entry in data["intrinsics"]}
        poses = {str(entry["poseId"]): _pose(entry["pose"]["transform"]) for entry in data.get("poses", [])}
        rigs = {
            str(entry["rigId"]): [_pose(part["pose"]) for part in entry["subPoses"]]
            for entry in data.get("rigs", [])
        }
        views = [view for entry in data["views"] for view in _view(entry, lenses, poses, rigs, places)]
    views.sort(key=lambda view: view.name)
    textured = project and find_mesh(sorted(project.glob("MeshroomCache/Texturing/*")), MESH_STEMS)
    return places.rig(NAME, views, "y", places.mesh() or textured)


def points(file: Path) -> np.ndarray:
    """The sparse points (N, 3), which the file has if it was converted with its structure.

    Raises:
        FiptError: ``rig-damaged``.
    """
    with WellFormed(file):
        stored = [numbers(entry["X"], 3) for entry in read_json_rig(file, dict).get("structure", [])]
    return np.array(stored).reshape(-1, 3) @ _MESH_FROM_SFM[:3, :3].T


def _pose(transform: dict) -> np.ndarray:
    """Camera-to-world (4, 4) with OpenCV axes."""
    pose = np.eye(4)
    pose[:3, :3] = numbers(transform["rotation"], 9).reshape(3, 3)
    pose[:3, 3] = numbers(transform["center"], 3)
    return pose


def _view(
    entry: dict,
    lenses: dict[str, tuple[tuple[int, int], Lens]],
    poses: dict[str, np.ndarray],
    rigs: dict[str, list[np.ndarray]],
    places: Places,
) -> list[RigView]:
    """The view of an entry, none where it has no pose or no camera."""
    pose = poses.get(str(entry.get("poseId", entry["viewId"])))
    camera = lenses.get(str(entry.get("intrinsicId")))
    if pose is None or camera is None:
        return []
    if "rigId" in entry and str(entry.get("isPoseIndependant", "true")).lower() == "false":
        pose = pose @ rigs[str(entry["rigId"])][int(number(entry["subPoseId"]))]
    return [places.view(str(entry["path"]), *camera, _MESH_FROM_SFM @ pose)]


def _lens(file: Path, entry: dict, version: tuple[int, ...]) -> tuple[tuple[int, int], Lens]:
    """Image size and lens of a camera."""
    size = pixel_size(entry["width"], entry["height"])
    fx, fy = _focal_lengths(entry, version, size)
    centre = numbers(entry["principalPoint"], 2)
    if version >= (1, 2, 1):
        centre = centre + [0.5 * size[0], 0.5 * size[1]]
    intrinsics = (fx, fy, float(centre[0]), float(centre[1]))
    kind, distortion = str(entry["type"]), str(entry.get("distortionType", "none"))
    if version < (1, 2, 8):
        kind, distortion = ("pinhole", _OLD_TYPES[kind]) if kind in _OLD_TYPES else (kind, distortion)
    undone = str(entry.get("undistortionType", "none"))
    if kind != "pinhole" or distortion not in _COUNTS or undone != "none":
        raise FiptError(
            "camera-model",
            f"{file} has the camera model {kind[:40]!r} with the distortion {distortion[:40]!r} "
            f"and the undistortion {undone[:40]!r}, which is not supported.",
            "Use the camera models pinhole, radial, brown or fisheye in Meshroom (node CameraInit).",
        )
    stored = entry.get("distortionParams") or [0.0] * _COUNTS[distortion]
    values = (
        tuple(float(value) for value in numbers(stored, _COUNTS[distortion])) if _COUNTS[distortion] else ()
    )
    if distortion == "fisheye":
        return size, Lens("OPENCV_FISHEYE", (*intrinsics, *values))
    if distortion == "fisheye1":
        return size, Lens("FOV", (*intrinsics, *values))
    tangential = (values[3], values[4]) if distortion == "brown" else (0.0, 0.0)
    return size, distorting_lens(intrinsics, size, values[:3], tangential)


def _focal_lengths(entry: dict, version: tuple[int, ...], size: tuple[int, int]) -> tuple[float, float]:
    """Focal lengths fx, fy in pixels, which each version stores in another way."""
    if version < (1, 2, 0):
        focal = number(entry["pxFocalLength"])
        return focal, focal
    if version < (1, 2, 2):
        both = numbers(entry["pxFocalLength"], 2)
        return float(both[0]), float(both[1])
    sensor, ratio = number(entry.get("sensorWidth", 36.0)), number(entry.get("pixelRatio", 1.0))
    if not (sensor > 0.0 and ratio > 0.0):
        raise ValueError("a camera has no sensor width, or an impossible pixel ratio")
    focal = number(entry["focalLength"]) / sensor * size[0]
    if version < (1, 2, 5):
        return focal, focal / ratio
    if version < (1, 2, 11):
        return focal, focal * ratio
    return focal / ratio, focal
