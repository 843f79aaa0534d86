# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader for OpenMVG's sfm_data.json, which Regard3D writes, too.

Source: OpenMVG's documentation, "SfM data format"; rotations are from the world to the camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...run.errors import FiptError
from ..options import CaptureOptions
from ..places import Places
from ..rig import Lens, Rig, WellFormed, read_json_rig
from .radial import distorting_lens
from .rig_files import camera_file, camera_pose, numbers, pixel_size

NAME = "openmvg"
LOOKS_FOR = "sfm_data.json with sfm_data_version"
FOLDERS = (".", "reconstruction", "reconstruction_sequential", "reconstruction_global")
_COUNTS = {"disto_k1": 1, "disto_k3": 3, "disto_t2": 5, "fisheye": 4}
# Cereal numbers the types in the order of their first appearance, with the highest bit set there.
_NEW_TYPE = 1 << 31


def find(path: Path) -> Path | None:
    """The camera file at a path or in a folder, None without one."""
    return camera_file(path, (".json",), lambda text: '"sfm_data_version"' in text, FOLDERS)


def read(file: Path, options: CaptureOptions) -> Rig:
    """Read all views with a pose. OpenMVG does not define an up axis.

    Raises:
        FiptError: ``rig-damaged`` or ``camera-model``.
    """
    places = Places.around(file, options, folders=FOLDERS)
    data = read_json_rig(file, dict)
    with WellFormed(file):
        kinds = _kinds(data["intrinsics"])
        lenses = {
            entry["key"]: _lens(file, kind, entry["value"]["ptr_wrapper"]["data"])
            for entry, kind in zip(data["intrinsics"], kinds, strict=True)
        }
        poses = {entry["key"]: entry["value"] for entry in data["extrinsics"]}
        views = []
        for entry in data["views"]:
            view = entry["value"]["ptr_wrapper"]["data"]
            if view["id_pose"] in poses and view["id_intrinsic"] in lenses:
                pose = poses[view["id_pose"]]
                rotation = np.array([numbers(row, 3) for row in pose["rotation"]])
                matrix = camera_pose(rotation.reshape(3, 3), numbers(pose["center"], 3))
                size, lens = lenses[view["id_intrinsic"]]
                parts = (data.get("root_path"), view.get("local_path"), view["filename"])
                name = "/".join(str(part) for part in parts if part)
                views.append(places.view(name, size, lens, matrix))
    views.sort(key=lambda view: view.name)
    return places.rig(NAME, views, None, places.mesh())


def points(file: Path) -> np.ndarray:
    """The sparse points (N, 3), which the file has unless it was exported without its structure.

    Raises:
        FiptError: ``rig-damaged``.
    """
    with WellFormed(file):
        stored = read_json_rig(file, dict).get("structure", [])
        return np.array([numbers(entry["value"]["X"], 3) for entry in stored]).reshape(-1, 3)


def _kinds(intrinsics: list[dict]) -> list[str]:
    """The type of each camera."""
    names: dict[int, str] = {}
    kinds = []
    for entry in intrinsics:
        value = entry["value"]
        identifier = int(value.get("polymorphic_id", 0))
        if "polymorphic_name" in value:
            names[identifier % _NEW_TYPE] = str(value["polymorphic_name"])
        kinds.append(names.get(identifier % _NEW_TYPE, "pinhole"))
    return kinds


def _lens(file: Path, kind: str, data: dict) -> tuple[tuple[int, int], Lens]:
    """Image size and lens of a camera; older files have the values of a pinhole one level deeper."""
    data = {**data.get("value0", {}), **data}
    size = pixel_size(data["width"], data["height"])
    name = next((key for key in _COUNTS if key in data), None)
    known = kind in ("pinhole", "pinhole_radial_k1", "pinhole_radial_k3", "pinhole_brown_t2", "fisheye")
    if not known or (name is None and kind != "pinhole"):
        raise FiptError(
            "camera-model",
            f"{file} has the camera model {kind[:40]!r}, which is not supported.",
            "Solve the cameras with a pinhole or fisheye model; split panoramas into views.",
        )
    centre = numbers(data["principal_point"], 2)
    focal = float(numbers([data["focal_length"]], 1)[0])
    intrinsics = (focal, focal, float(centre[0]), float(centre[1]))
    values = tuple(float(value) for value in numbers(data[name], _COUNTS[name])) if name else ()
    if name == "fisheye":
        return size, Lens("OPENCV_FISHEYE", (*intrinsics, *values))
    tangential = (values[3], values[4]) if name == "disto_t2" else (0.0, 0.0)
    return size, distorting_lens(intrinsics, size, values[:3], tangential)
