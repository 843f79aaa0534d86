# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for OpenSfM's reconstruction.json, which OpenDroneMap writes, too.

Source: OpenSfM's documentation, "Dataset Structure" and "Geometric Models".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...run.errors import FiptError
from ...run.kinds import Vector
from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import EQUIRECTANGULAR, Lens, Rig, RigView, WellFormed, damaged, read_json_rig
from .radial import distorting_lens
from .rig_files import camera_file, camera_pose, head, largest_model, pixel_size

NAME = "opensfm"
LOOKS_FOR = "reconstruction.json with cameras and shots"
FOLDERS = (".", "opensfm")


@dataclass(frozen=True)
class _Camera:
    width: float
    height: float
    projection_type: str = "perspective"
    focal: float = 0.0
    focal_x: float | None = None
    focal_y: float | None = None
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    c_x: float = 0.0
    c_y: float = 0.0


@dataclass(frozen=True)
class _Shot:
    camera: str
    rotation: Vector
    translation: Vector


@dataclass(frozen=True)
class _Model:
    cameras: dict[str, _Camera]
    shots: dict[str, _Shot]


@dataclass(frozen=True)
class _Point:
    coordinates: Vector


@dataclass(frozen=True)
class _ModelPoints:
    shots: dict[str, Any]
    points: dict[str, _Point] = field(default_factory=dict)


def find(path: Path) -> Path | None:
    """A JSON file at a path or in a folder that is a list of reconstructions, None without one."""
    for folder in (path / name for name in FOLDERS):  # beside it may be others in map coordinates
        if _is_reconstruction(head(folder / "reconstruction.json")):
            return folder / "reconstruction.json"
    return camera_file(path, (".json",), _is_reconstruction, FOLDERS)


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all shots of the largest reconstruction. The world is Z up, as OpenSfM aligns it.

    Raises:
        FiptError: ``rig-damaged`` or ``camera-model``.
    """
    models = read_json_rig(file, tuple[_Model, ...])
    places = Places.around(file, options, folders=FOLDERS)
    views, notes = largest_model([_views(file, model, places) for model in models], str(file))
    mesh = places.mesh((*MESH_STEMS, "odm_mesh"), (".", "odm_meshing", "undistorted"))
    return places.rig(NAME, views, "z", mesh, notes)


def points(file: Path) -> np.ndarray:
    """The sparse points (N, 3) of the largest reconstruction.

    Raises:
        FiptError: ``rig-damaged``.
    """
    models = read_json_rig(file, tuple[_ModelPoints, ...])
    with WellFormed(file):
        largest = max(models, key=lambda model: len(model.shots))
    return np.array([point.coordinates for point in largest.points.values()]).reshape(-1, 3)


def _is_reconstruction(text: str) -> bool:
    return text.lstrip().startswith("[") and '"cameras"' in text


def _views(file: Path, model: _Model, places: Places) -> list[RigView]:
    views = []
    for name, shot in sorted(model.shots.items()):
        if shot.camera not in model.cameras:
            raise damaged(file, f"the shot {name} has the camera {shot.camera}, which is not there")
        camera = model.cameras[shot.camera]
        with WellFormed(file):
            size = pixel_size(camera.width, camera.height)
        world_to_camera = Rotation.from_rotvec(shot.rotation).as_matrix()
        centre = -world_to_camera.T @ np.array(shot.translation)
        views.append(places.view(name, size, _lens(file, camera, size), camera_pose(world_to_camera, centre)))
    return views


def _lens(file: Path, camera: _Camera, size: tuple[int, int]) -> Lens:
    """The lens of a camera; OpenSfM's image coordinates are divided by the longer side, from the centre."""
    side = float(max(size))
    kind, focal = camera.projection_type, camera.focal
    if kind in ("spherical", "equirectangular"):
        return Lens(EQUIRECTANGULAR, (float(size[0]), float(size[1])))
    fx, fy = (side * (focal if own is None else own) for own in (camera.focal_x, camera.focal_y))
    intrinsics = (fx, fy, 0.5 * size[0] + camera.c_x * side, 0.5 * size[1] + camera.c_y * side)
    k1, k2, k3, tangential = camera.k1, camera.k2, camera.k3, (camera.p1, camera.p2)
    if fx <= 0.0 or fy <= 0.0:
        raise FiptError(
            "intrinsics-missing", f"{file} has a camera without focal length.", "Solve the cameras again."
        )
    if kind in ("perspective", "simple_radial", "radial"):
        return distorting_lens(intrinsics, size, (k1, k2))
    if kind == "brown":
        return distorting_lens(intrinsics, size, (k1, k2, k3), tangential)
    if kind in ("fisheye", "fisheye_opencv"):
        return Lens("OPENCV_FISHEYE", (*intrinsics, k1, k2, k3, camera.k4))
    raise FiptError(
        "camera-model",
        f"{file} has the projection type {kind[:40]!r}, which has no pinhole camera or is not supported.",
        "Use the types perspective, brown, fisheye, fisheye_opencv or spherical in OpenSfM.",
    )
