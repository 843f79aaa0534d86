"""Reading a capture folder of the example's layout (OBJ, tables, cameras), and writing EXR images."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR


@dataclass
class Capture:
    """A capture folder as arrays.

    Attributes:
        corners, normals: (T, 3, 3) positions and shading normals of the triangles' corners, Y up, metres.
        uv: (T, 3, 2), zero for objects without UVs. V points up.
        material: (T,) ids from 1 on. part: (T,) object ids from 0 on.
        materials, emitters, relight: the tables of the JSON files.
        poses: by split, 4x4 camera-to-world (camera axes X left, Y up, Z forward).
        fov_x: horizontal field of view in radians.
    """

    folder: Path
    corners: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    material: np.ndarray
    part: np.ndarray
    materials: list[dict[str, Any]]
    emitters: list[dict[str, Any]]
    relight: dict[str, Any]
    poses: dict[str, list[np.ndarray]]
    fov_x: float
    width: int
    height: int


def obj_rows(path: Path) -> tuple[dict[str, list[list[float]]], np.ndarray]:
    """Rows of `v`, `vt` and `vn` of a triangulated OBJ, and (T, 3, 1 to 3) numbers of its faces (0: none)."""
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces = []
    for line in path.read_text().splitlines():
        kind, _, rest = line.partition(" ")
        if kind in rows:
            rows[kind].append([float(word) for word in rest.split()])
        elif kind == "f":
            faces.append([[int(number or 0) for number in word.split("/")] for word in rest.split()])
    return rows, np.array(faces)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(corners, normals, uv) of a triangulated OBJ whose faces are `v/t/n` or `v//n`."""
    rows, index = obj_rows(path)
    uv = np.array([[0.0, 0.0], *rows["vt"]], np.float32)  # index 0: no UV
    corners, normals = (np.array(rows[kind], np.float32) for kind in ("v", "vn"))
    return corners[index[..., 0] - 1], normals[index[..., 2] - 1], uv[index[..., 1]]


def read_capture(folder: Path) -> Capture:
    """Everything but the images."""
    corners, normals, uv = read_obj(folder / "scene.obj")
    with np.load(folder / "scene.npz", allow_pickle=False) as table:
        material, part = table["material"], table["part"]
    cameras = {name: json.loads((folder / name / "transforms.json").read_text()) for name in ("train", "val")}
    return Capture(
        folder,
        corners,
        normals,
        uv,
        material,
        part,
        materials=json.loads((folder / "materials.json").read_text())["materials"],
        emitters=json.loads((folder / "emitters.json").read_text()),
        relight=json.loads((folder / "relight.json").read_text()),
        poses={
            name: [np.array(f["transform_matrix"]) for f in table["frames"]]
            for name, table in cameras.items()
        },
        fov_x=cameras["train"]["camera_angle_x"],
        width=cameras["train"]["width"],
        height=cameras["train"]["height"],
    )


def write_exr(path: Path, values: np.ndarray) -> None:
    """One image (H, W, 3) as RGB or (H, W) as Y, ZIP-compressed, in its own float type."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB" if values.ndim == 3 else "Y": np.ascontiguousarray(values)}
    OpenEXR.File(header, channels).write(str(path))


def read_exr(path: Path) -> np.ndarray:
    """The RGB or Y channel of an EXR image."""
    return next(iter(OpenEXR.File(str(path)).channels().values())).pixels
