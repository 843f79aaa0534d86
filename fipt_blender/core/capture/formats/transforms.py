"""Reader for transforms.json as nerfstudio, instant-ngp and NeRF's synthetic scenes write it."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from ...conventions import UP_AXES, opengl_to_opencv_camera, transform_poses
from ...run.errors import FiptError, Problem, problem
from ...run.kinds import Number, choice
from ...run.shapes import MOST_SIDE
from ..depth_images import registered_depths
from ..files import key, name_parts, stem_of
from ..options import CaptureOptions
from ..places import Places
from ..rig import (
    EQUIRECTANGULAR,
    DepthView,
    Lens,
    Rig,
    RigView,
    WellFormed,
    find_mesh,
    read_json_rig,
    read_pose,
)
from .radial import distorting_lens
from .rig_files import camera_files, head, unsupported

NAME = "transforms"
LOOKS_FOR = "transforms.json or transforms_train.json"
# One file per split, as in NeRF's synthetic scenes.
SPLIT_FILES = {
    "transforms_train.json": "train",
    "transforms_val.json": "held_back",
    "transforms_test.json": "held_back",
}
SPLIT_LISTS = {"train_filenames": "train", "val_filenames": "held_back", "test_filenames": "held_back"}
PINHOLES = ("", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
Side = Annotated[float, Number(1, MOST_SIDE)]


@dataclass(frozen=True, kw_only=True)
class Common:
    """What stands in each frame, or once for all frames."""

    w: Side | None = None
    h: Side | None = None
    cx: float | None = None
    cy: float | None = None
    fl_x: float | None = None
    fl_y: float | None = None
    camera_angle_x: float | None = None
    camera_angle_y: float | None = None
    x_fov: float | None = None
    y_fov: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None
    camera_model: str | None = None
    is_fisheye: bool | None = None
    latlong: bool | None = None
    equirectangular: bool | None = None
    orthographic: bool | None = None
    ftheta_p0: float | None = None
    mask_path: str | None = None
    depth_file_path: str | None = None
    depth_path: str | None = None
    name: str | None = None


@dataclass(frozen=True, kw_only=True)
class Frame(Common):
    """A photograph."""

    file_path: str
    transform_matrix: list = field(default_factory=list)
    transform_matrix_start: list | None = None
    is_bad: bool | None = None


@dataclass(frozen=True, kw_only=True)
class Transforms(Common):
    """A file with frames."""

    frames: tuple[Frame, ...]
    train_filenames: tuple[str, ...] | None = None
    val_filenames: tuple[str, ...] | None = None
    test_filenames: tuple[str, ...] | None = None
    up_axis: Annotated[str, choice(*UP_AXES)] | None = None
    applied_transform: list | None = None
    applied_scale: float = 1.0
    depth_unit_scale_factor: float | None = None
    integer_depth_scale: float | None = None

    def whole(self, frame: Frame) -> Frame:
        """A frame with what stands once for all."""
        missing = (item.name for item in fields(Common) if getattr(frame, item.name) is None)
        return replace(frame, **{name: getattr(self, name) for name in missing})


def find(path: Path) -> Path | None:
    """The path of a JSON file with frames, or of a folder that contains such camera files, else None."""
    if path.is_file():
        return path if path.suffix.lower() == ".json" and '"frames"' in head(path) else None
    names = ("transforms.json", "transforms_train.json")
    files = [path / name for name in names if (path / name).is_file()]
    # A list is what nerfstudio exports of its own scene: poses without cameras.
    if any(not head(file).lstrip().startswith("[") for file in files):
        return path
    # Under another name: "transforms (1).json"
    others = [] if files else [file for file in camera_files(path, (".json",)) if _is_named_otherwise(file)]
    return others[0] if len(others) == 1 else None


def _is_named_otherwise(file: Path) -> bool:
    return "transform" in file.stem.lower() and '"frames"' in (text := head(file)) and '"file_path"' in text


def read(path: Path, options: CaptureOptions) -> Rig:
    """Read the frames of transforms.json, or of transforms_train|val|test.json.

    Cameras have OpenGL axes. The world is that of the poses as stored (Z up unless the file has another
    "up_axis"), or with ``undo_applied_transform`` the one before nerfstudio's ``applied_transform``.
    Intrinsics (fl_x, fl_y, cx, cy, w, h, k1 k2 p1 p2 k3, or k1 to k4 of a fisheye) belong to each frame or to
    the whole file; ``camera_angle_x`` and ``camera_angle_y`` replace missing focal lengths, and so do
    instant-ngp's ``x_fov`` and ``y_fov`` in degrees. A panorama (``camera_model`` EQUIRECTANGULAR, or
    ``latlong``) has none of them; its centre shows what is before the camera. Black
    pixels of a frame's ``mask_path`` are left out. Depth images are nerfstudio's ``depth_file_path`` and
    NeRFCapture's ``depth_path``, in the unit that the file has. A frame may name its view with ``name``, our
    own extension.
    """
    if path.is_file():
        files: dict[Path, str | None] = {path: None}
    elif (path / "transforms.json").is_file():
        files = {path / "transforms.json": None}
    else:
        files = {path / name: split for name, split in SPLIT_FILES.items() if (path / name).is_file()}
    root = path.parent if path.is_file() else path
    places = Places(
        next(iter(files)),
        (root,),
        options.images,
        (".",),
        inside=root,
        own_paths=options.own_paths,
        relative=True,
    )
    notes: list[Problem] = []
    views: list[RigView] = []
    depths: list[DepthView] = []
    up_axis: str | None = None
    for json_path, split in files.items():
        data = read_json_rig(json_path, Transforms)
        undo = _applied_inverse(json_path, data) if options.undo_applied_transform else None
        # The up axis from before the applied transform is not stored.
        up_axis = data.up_axis or ("z" if undo is None else None)
        lists = {name: split for key, split in SPLIT_LISTS.items() for name in getattr(data, key) or ()}
        split_of = {_identity(places, name): split for name, split in lists.items()}
        for frame in data.frames:
            if frame.is_bad:
                continue
            own = split_of.pop(_identity(places, frame.file_path), split) if split_of else split
            view = frame_view(json_path, data.whole(frame), own, places)
            if undo is not None:
                view = replace(view, camera_to_world=transform_poses(undo, view.camera_to_world))
            views.append(view)
            if (name := frame.depth_file_path or frame.depth_path) and view.lens.model == "PINHOLE":
                image = places.depth(json_path.parent, name)
                unit = data.integer_depth_scale if frame.depth_path else data.depth_unit_scale_factor
                depths += registered_depths([view], [image], unit or options.depth_unit)
        if split_of:
            text = f"{len(split_of)} of {len(lists)} names in the splits of {json_path} belong to no frame"
            text += f"; the first is {next(name for name in lists if _identity(places, name) in split_of)}."
            notes.append(problem("splits-unknown", text=text))
    beside = {path for view in views for path in view.image.parent.glob("dynamic_mask_*")}
    if beside:
        text = (
            f"{len(beside)} masks of instant-ngp ({min(beside)}) are not used: what is white is masked there."
        )
        notes.append(problem("masks-unused", text=text))
    mesh = find_mesh([root], ["scene", "mesh", "meshed-poisson", "poisson_mesh"])
    return places.rig(NAME, views, up_axis, mesh, notes, tuple(depths))


def _identity(places: Places, name: str) -> Path | str:
    """What names of one photograph have in common: its file, or how they are written where it is missing."""
    with suppress(FiptError):  # its size may tell later which one it is
        if found := places.find(name):
            return found.path
    return key("/".join(name_parts(stem_of(name))))


def frame_view(json_path: Path, frame: Frame, split: str | None, places: Places) -> RigView:
    """One view, with the pose as stored.

    Args:
        json_path: of the file.
        frame: with what stands once for all.
        split: of the view.
        places: where its photograph is.
    """
    if frame.transform_matrix_start is not None and not frame.transform_matrix:
        raise FiptError("pose-unsupported.frame-view", json_path=json_path)
    pose = opengl_to_opencv_camera(read_pose(json_path, frame.transform_matrix))
    with WellFormed(json_path):
        width, height = int(frame.w or 0), int(frame.h or 0)
        # The size for all frames need not be that of a panorama among other photographs.
        if not (width and height) or _model(frame) == EQUIRECTANGULAR:
            width, height = places.size(frame.file_path)
        lens = _lens(json_path, frame, width, height)
    return places.view(
        frame.file_path,
        (width, height),
        lens,
        pose,
        called=frame.name or "",
        split=split,
        mask=frame.mask_path,
    )


def _lens(json_path: Path, frame: Frame, width: int, height: int) -> Lens:
    model = _model(frame)
    if model == EQUIRECTANGULAR:
        return Lens(EQUIRECTANGULAR, (float(width), float(height)))
    k1, k2, k3, k4, p1, p2 = (getattr(frame, key) or 0.0 for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    fisheye = model in FISHEYES or (frame.is_fisheye and model in PINHOLES)
    # COLMAP's FULL_OPENCV divides by a polynomial with k4; nerfstudio's k4 multiplies, as no model here does.
    if not fisheye and (model not in PINHOLES or k4 != 0.0):
        what = f"the camera model {model or 'pinhole'}{' with k4' if k4 != 0.0 else ''}"
        raise unsupported(json_path, what, "Export perspective, OpenCV fisheye or equirectangular images.")
    fx, fy = _focal_lengths(json_path, frame, width, height)
    cx, cy = frame.cx, frame.cy
    intrinsics = (fx, fy, 0.5 * width if cx is None else cx, 0.5 * height if cy is None else cy)
    if fisheye:
        return Lens("OPENCV_FISHEYE", (*intrinsics, k1, k2, k3, k4))
    return distorting_lens(intrinsics, (width, height), (k1, k2, k3), (p1, p2))


def _model(frame: Frame) -> str:
    """The camera model, which instant-ngp names by a key of its own."""
    if frame.latlong:
        return EQUIRECTANGULAR
    if frame.equirectangular:
        return "EQUAL_AREA"  # whatever instant-ngp calls it: rows are proportional to the height
    if frame.orthographic or frame.ftheta_p0 is not None:
        return "ORTHOGRAPHIC" if frame.orthographic else "FTHETA"
    return (frame.camera_model or "").upper()


def _focal_lengths(json_path: Path, frame: Frame, width: int, height: int) -> tuple[float, float]:
    """Focal lengths fx, fy in pixels; a missing one is that of the other axis (square pixels)."""
    for name in ("camera_angle_x", "camera_angle_y", "x_fov", "y_fov"):
        angle, radians = getattr(frame, name), name.startswith("camera")
        if angle and (angle >= math.pi if radians else angle < math.pi):
            names = ("radians", "degrees") if radians else ("degrees", "radians")
            raise FiptError("intrinsics-invalid.angle", json_path=json_path, key=name, angle=angle,
                            expected=names[0], given=names[1])  # fmt: skip
    angle_x = frame.camera_angle_x or math.radians(frame.x_fov or 0.0)
    angle_y = frame.camera_angle_y or math.radians(frame.y_fov or 0.0)
    fx = frame.fl_x or (0.5 * width / math.tan(0.5 * angle_x) if angle_x else None)
    fy = frame.fl_y or (0.5 * height / math.tan(0.5 * angle_y) if angle_y else None)
    if fx is None and fy is None:
        raise FiptError("intrinsics-missing.focal-lengths", json_path=json_path, file_path=frame.file_path)
    fx = fy if fx is None else fx
    return float(fx), float(fx if fy is None else fy)  # type: ignore[arg-type]


def _applied_inverse(json_path: Path, data: Transforms) -> np.ndarray:
    """Similarity (4, 4) from the file's world to the one before applied_transform and applied_scale."""
    applied = np.eye(4)
    if data.applied_transform is not None:
        applied = read_pose(json_path, data.applied_transform)
    with WellFormed(json_path):
        applied[:3] *= data.applied_scale
        return np.linalg.inv(applied)
