# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every capture reader returns: photographs, lenses and poses in the coordinates of their source.

Poses already have OpenCV camera axes; the world is still the source's own. `ingest` does the rest.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..job.errors import FiptError
from .images import MASK_SUFFIXES

PHOTO_SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")
MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf")
PARTS_FOLDER = "parts"
SEMANTICS_FOLDER = "semantics"


@dataclass(frozen=True)
class Lens:
    """A camera model by COLMAP's name with COLMAP's parameters in pixels, e.g. PINHOLE (fx, fy, cx, cy)."""

    model: str
    parameters: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class RigView:
    """One photograph as its source describes it.

    Attributes:
        name: path-like name without suffix.
        split: ``"train"``, ``"held_back"`` or None where the format has no splits.
        image: the photograph; the reader does not promise that it exists.
        width, height: size in pixels that the lens is calibrated for.
        lens: intrinsics and distortion.
        camera_to_world: (4, 4) float64, OpenCV axes, source world.
        parts, semantics: id images that exist, or None.
        mask: image whose black pixels are left out, or None; the reader does not promise that it exists.
    """

    name: str
    split: str | None
    image: Path
    width: int
    height: int
    lens: Lens
    camera_to_world: np.ndarray
    parts: Path | None = None
    semantics: Path | None = None
    mask: Path | None = None


@dataclass(frozen=True)
class Note:
    """Something the user should know about the source; becomes a warning."""

    code: str
    text: str
    remedy: str


@dataclass(frozen=True, eq=False)
class Rig:
    """A capture as its source describes it.

    Attributes:
        source: name of the format.
        views: all photographs with a pose.
        up_axis: the source axis that points up (see `conventions.UP_AXES`), None where the format leaves
            it open.
        mesh: mesh file in the same coordinates as the poses, or None where none lies beside the rig.
        notes: warnings.
    """

    source: str
    views: tuple[RigView, ...]
    up_axis: str | None
    mesh: Path | None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class ReadOptions:
    """What the user may tell a reader.

    Attributes:
        images: folder to look for photographs in before any other.
        undo_applied_transform: transforms.json only: bring the poses back to the coordinates they had
            before nerfstudio's ``applied_transform`` and ``applied_scale``.
    """

    images: Path | None = None
    undo_applied_transform: bool = False


def damaged(path: Path, reason: object) -> FiptError:
    """The error for a rig file that does not hold what its format promises."""
    return FiptError(
        "rig-damaged",
        f"{path} does not hold what its format promises ({reason}).",
        "Export the capture again.",
    )


def read_json_rig(path: Path) -> dict[str, Any]:
    """Read a JSON object that describes cameras.

    Raises:
        FiptError: ``rig-damaged``.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise damaged(path, error) from None
    if not isinstance(data, dict) or not isinstance(data.get("frames"), list):
        raise damaged(path, "there is no list 'frames'")
    return data


def read_pose(path: Path, matrix: Any) -> np.ndarray:
    """A (4, 4) float64 pose from nested lists of 3 or 4 rows.

    Raises:
        FiptError: ``rig-damaged``.
    """
    try:
        values = np.array(matrix, np.float64)
        if values.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"a matrix has shape {values.shape}")
    except (TypeError, ValueError) as error:
        raise damaged(path, error) from None
    pose = np.eye(4)
    pose[:3] = values[:3]
    return pose


def find_image(folders: Iterable[Path], name: str) -> Path:
    """The photograph of a name that a rig file gives: its EXR version first, then the file itself.

    Rigs are often solved on tone-mapped copies, so that ``a.jpg`` may stand for ``a.exr``; names may
    also lack a suffix. Where nothing exists, the path in the first folder is returned.
    """
    folders = list(folders)
    # names end in a known suffix or in none; a dot in "frame.0001" is no suffix
    known = PurePosixPath(name).suffix.lower() in PHOTO_SUFFIXES
    stem = name[: -len(PurePosixPath(name).suffix)] if known else name
    candidates = [stem + ".exr", *([name] if known else [stem + suffix for suffix in PHOTO_SUFFIXES])]
    for candidate in candidates:
        for folder in folders:
            if (folder / candidate).is_file():
                return folder / candidate
    return folders[0] / (name if known else candidates[0])


def find_ids(folder: Path, name: str) -> Path | None:
    """The id image of a view in a folder that mirrors that of the photographs, EXR or PNG, or None."""
    _, _, below = name.partition("/")  # images/a may be parts/a as well as parts/images/a
    for stem in (name, below):
        for suffix in MASK_SUFFIXES:
            path = folder / (stem + suffix)
            if stem and path.is_file():
                return path
    return None


def view_name(path: str) -> str:
    """A view's name from a file path: no suffix, no way out of a folder."""
    pure = PurePosixPath(path.replace("\\", "/"))
    if pure.suffix.lower() in PHOTO_SUFFIXES:
        pure = pure.with_suffix("")
    parts = [part for part in pure.parts if part not in ("..", ".") and not part.endswith((":", "/"))]
    return "/".join(parts) or "view"


def find_mesh(folders: Sequence[Path], stems: Sequence[str]) -> Path | None:
    """The first mesh with triangles among STEM.obj, .ply, .glb, .gltf; folders matter more than stems."""
    for folder in folders:
        for stem in stems:
            for suffix in MESH_SUFFIXES:
                path = folder / (stem + suffix)
                if path.is_file() and (suffix != ".ply" or _ply_has_faces(path)):
                    return path
    return None


def _ply_has_faces(path: Path) -> bool:
    """Whether a PLY's header announces faces: COLMAP's fused.ply is a mere point cloud."""
    with path.open("rb") as file:
        for line in file.read(65536).split(b"\n"):
            words = line.split()
            if words[:2] == [b"element", b"face"]:
                return words[2:] != [b"0"]
            if words[:1] == [b"end_header"]:
                return False
    return False
