"""Readers of solves in JSON files: Meshroom, OpenSfM (also OpenDroneMap) and OpenMVG (also Regard3D).

Sources: AliceVision's sfmDataIO; the documentation of OpenSfM, "Dataset Structure" and "Geometric Models",
and of OpenMVG, "SfM data format".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...alignment.turns import turn_by
from ...run.errors import FiptError
from ...run.kinds import Vector
from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import EQUIRECTANGULAR, Lens, RigView, WellFormed, damaged, read_json_rig
from .radial import Intrinsics, distorting_lens
from .rig_files import Models, Program, camera_pose, head, number, numbers, pixel_size, unsupported

# Meshroom writes meshes with Y and Z negated, which the poses follow here.
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
# Numbers of coefficients of Meshroom's distortions, and of OpenMVG's by their keys.
_MESHROOM_COUNTS = {"none": 0, "radialk1": 1, "radialk3": 3, "brown": 5, "fisheye": 4, "fisheye1": 1}
_OPENMVG_COUNTS = {"disto_k1": 1, "disto_k3": 3, "disto_t2": 5, "fisheye": 4}
# Cereal numbers the types in the order of their first appearance, with the highest bit set there.
_NEW_TYPE = 1 << 31


# ------------------------------------------------------------------------------------------------- Meshroom


@dataclass(frozen=True)
class _Meshroom(Program):
    """A project's folder has the cameras and meshes of its nodes in MeshroomCache."""

    def find(self, path: Path) -> Path | None:
        """As of `Program`; of a project's several nodes the one that was computed last."""
        nodes = (path if path.is_dir() else path.parent).glob("MeshroomCache/StructureFromMotion/*")
        computed = [file for node in nodes if (file := self.find(node))]
        return super().find(path) or max(computed, key=lambda file: file.stat().st_mtime, default=None)

    def places(self, file: Path, options: CaptureOptions) -> Places:
        """Where the photographs and meshes of a camera file are."""
        project = next((folder.parent for folder in file.parents if folder.name == "MeshroomCache"), None)
        if project is None:
            return super().places(file, options)
        nodes = sorted(project.glob("MeshroomCache/Texturing/*"))
        return Places(file, (project, *nodes), options.images, inside=project)


def _meshroom(file: Path, places: Places) -> Models:
    """All views with a pose, those of rigs included. The world is Y up, as in Meshroom's viewer.

    Matrices are stored column by column, so that a rotation read row by row leads from the camera to the
    world.
    """
    data = read_json_rig(file, dict)
    version = tuple(int(value) for value in numbers(data["version"], 3))
    lenses = {str(entry["intrinsicId"]): _meshroom_lens(file, entry, version) for entry in data["intrinsics"]}
    poses = {str(entry["poseId"]): _pose(entry["pose"]["transform"]) for entry in data.get("poses", [])}
    rigs = {
        str(entry["rigId"]): [_pose(part["pose"]) for part in entry["subPoses"]]
        for entry in data.get("rigs", [])
    }
    views = [view for entry in data["views"] for view in _meshroom_view(entry, lenses, poses, rigs, places)]
    return [views], ()


def _meshroom_points(file: Path) -> np.ndarray:
    """The sparse points (N, 3), which the file has if it was converted with its structure."""
    with WellFormed(file):
        stored = [numbers(entry["X"], 3) for entry in read_json_rig(file, dict).get("structure", [])]
    return np.array(stored).reshape(-1, 3) @ _MESH_FROM_SFM[:3, :3].T


def _pose(transform: dict) -> np.ndarray:
    """Camera-to-world (4, 4) with OpenCV axes."""
    pose = np.eye(4)
    pose[:3, :3] = numbers(transform["rotation"], 9).reshape(3, 3)
    pose[:3, 3] = numbers(transform["center"], 3)
    return pose


def _meshroom_view(
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


def _meshroom_lens(file: Path, entry: dict, version: tuple[int, ...]) -> tuple[tuple[int, int], Lens]:
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
    if kind != "pinhole" or distortion not in _MESHROOM_COUNTS or undone != "none":
        raise unsupported(
            file,
            f"the camera model {kind[:40]!r} with the distortion {distortion[:40]!r} and the undistortion"
            f" {undone[:40]!r}",
            "Use the camera models pinhole, radial, brown or fisheye in Meshroom (node CameraInit).",
        )
    count = _MESHROOM_COUNTS[distortion]
    stored = entry.get("distortionParams") if count else []
    return size, _lens(distortion, intrinsics, size, numbers(stored or [0.0] * count, count))


def _lens(kind: str, intrinsics: Intrinsics, size: tuple[int, int], values: np.ndarray) -> Lens:
    """The lens of a fisheye's coefficients, or of up to three radial ones and two tangential ones."""
    stored = tuple(values.tolist())
    if kind.startswith("fisheye"):
        return Lens("FOV" if kind == "fisheye1" else "OPENCV_FISHEYE", (*intrinsics, *stored))
    return distorting_lens(intrinsics, size, stored[:3], (*stored[3:], 0.0, 0.0)[:2])


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


# -------------------------------------------------------------------------------------------------- OpenSfM


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


@dataclass(frozen=True)
class _OpenSfM(Program):
    """A folder may hold the same cameras in map coordinates, too."""

    def find(self, path: Path) -> Path | None:
        """As of `Program`; first the file of the usual name."""
        files = [path / name / "reconstruction.json" for name in self.folders]
        return next((file for file in files if self.known(head(file))), None) or super().find(path)


def _opensfm(file: Path, places: Places) -> Models:
    """All shots of each reconstruction. The world is Z up, as OpenSfM aligns it."""
    models = read_json_rig(file, tuple[_Model, ...])
    return [_opensfm_views(file, model, places) for model in models], ()


def _opensfm_points(file: Path) -> np.ndarray:
    """The sparse points (N, 3) of the largest reconstruction."""
    models = read_json_rig(file, tuple[_ModelPoints, ...])
    with WellFormed(file):
        largest = max(models, key=lambda model: len(model.shots))
    return np.array([point.coordinates for point in largest.points.values()]).reshape(-1, 3)


def _opensfm_views(file: Path, model: _Model, places: Places) -> list[RigView]:
    views = []
    for name, shot in sorted(model.shots.items()):
        if shot.camera not in model.cameras:
            raise damaged(file, f"the shot {name} has the camera {shot.camera}, which is not there")
        camera = model.cameras[shot.camera]
        with WellFormed(file):
            size = pixel_size(camera.width, camera.height)
        world_to_camera = turn_by(np.array(shot.rotation))
        centre = -world_to_camera.T @ np.array(shot.translation)
        views.append(
            places.view(name, size, _opensfm_lens(file, camera, size), camera_pose(world_to_camera, centre))
        )
    return views


def _opensfm_lens(file: Path, camera: _Camera, size: tuple[int, int]) -> Lens:
    """The lens of a camera; OpenSfM's image coordinates are divided by the longer side, from the centre."""
    side = float(max(size))
    kind, focal = camera.projection_type, camera.focal
    if kind in ("spherical", "equirectangular"):
        return Lens(EQUIRECTANGULAR, (float(size[0]), float(size[1])))
    fx, fy = (side * (focal if own is None else own) for own in (camera.focal_x, camera.focal_y))
    intrinsics = (fx, fy, 0.5 * size[0] + camera.c_x * side, 0.5 * size[1] + camera.c_y * side)
    k1, k2, k3, tangential = camera.k1, camera.k2, camera.k3, (camera.p1, camera.p2)
    if fx <= 0.0 or fy <= 0.0:
        raise FiptError("intrinsics-missing.opensfm-lens", file=file)
    if kind in ("perspective", "simple_radial", "radial"):
        return distorting_lens(intrinsics, size, (k1, k2))
    if kind == "brown":
        return distorting_lens(intrinsics, size, (k1, k2, k3), tangential)
    if kind in ("fisheye", "fisheye_opencv"):
        return Lens("OPENCV_FISHEYE", (*intrinsics, k1, k2, k3, camera.k4))
    remedy = "Use the types perspective, brown, fisheye, fisheye_opencv or spherical in OpenSfM."
    raise unsupported(file, f"the projection type {kind[:40]!r}", remedy)


# -------------------------------------------------------------------------------------------------- OpenMVG


def _openmvg(file: Path, places: Places) -> Models:
    """All views with a pose; rotations are from the world to the camera."""
    data = read_json_rig(file, dict)
    lenses = {
        entry["key"]: _openmvg_lens(file, kind, entry["value"]["ptr_wrapper"]["data"])
        for entry, kind in zip(data["intrinsics"], _kinds(data["intrinsics"]), strict=True)
    }
    poses = {entry["key"]: entry["value"] for entry in data["extrinsics"]}
    views = []
    for entry in data["views"]:
        view = entry["value"]["ptr_wrapper"]["data"]
        if view["id_pose"] in poses and view["id_intrinsic"] in lenses:
            pose = poses[view["id_pose"]]
            rotation = np.array([numbers(row, 3) for row in pose["rotation"]])
            matrix = camera_pose(rotation.reshape(3, 3), numbers(pose["center"], 3))
            parts = (data.get("root_path"), view.get("local_path"), view["filename"])
            name = "/".join(str(part) for part in parts if part)
            views.append(places.view(name, *lenses[view["id_intrinsic"]], matrix))
    return [views], ()


def _openmvg_points(file: Path) -> np.ndarray:
    """The sparse points (N, 3), which the file has unless it was exported without its structure."""
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


def _openmvg_lens(file: Path, kind: str, data: dict) -> tuple[tuple[int, int], Lens]:
    """Image size and lens of a camera; older files have the values of a pinhole one level deeper."""
    data = {**data.get("value0", {}), **data}
    size = pixel_size(data["width"], data["height"])
    name = next((key for key in _OPENMVG_COUNTS if key in data), None)
    known = kind in ("pinhole", "pinhole_radial_k1", "pinhole_radial_k3", "pinhole_brown_t2", "fisheye")
    if not known or (name is None and kind != "pinhole"):
        remedy = "Solve the cameras with a pinhole or fisheye model; split panoramas into views."
        raise unsupported(file, f"the camera model {kind[:40]!r}", remedy)
    centre = numbers(data["principal_point"], 2)
    focal = float(numbers([data["focal_length"]], 1)[0])
    intrinsics = (focal, focal, float(centre[0]), float(centre[1]))
    values = numbers(data[name], _OPENMVG_COUNTS[name]) if name else np.zeros(0)
    return size, _lens(name or kind, intrinsics, size, values)


PROGRAMS = (
    _Meshroom(
        "meshroom",
        "an .sfm or .json file with version, views, intrinsics and poses",
        (".sfm", ".json"),
        lambda text: all(key in text for key in ('"version"', '"views"', '"viewId"')),
        _meshroom,
        _meshroom_points,
        up="y",
    ),
    _OpenSfM(
        "opensfm",
        "reconstruction.json with cameras and shots",
        (".json",),
        lambda text: text.lstrip().startswith("[") and '"cameras"' in text,
        _opensfm,
        _opensfm_points,
        folders=(".", "opensfm"),
        up="z",
        meshes=((*MESH_STEMS, "odm_mesh"), (".", "odm_meshing", "undistorted")),
    ),
    Program(
        "openmvg",
        "sfm_data.json with sfm_data_version",
        (".json",),
        lambda text: '"sfm_data_version"' in text,
        _openmvg,
        _openmvg_points,
        folders=(".", "reconstruction", "reconstruction_sequential", "reconstruction_global"),
    ),
)
