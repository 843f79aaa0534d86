"""What every capture reader returns: photographs, lenses and poses in the coordinates of their source.

Poses have OpenCV camera axes; the world is still that of the source, which `ingest` converts.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np

from ..run.documents import load_document
from ..run.errors import FiptError, Problem
from ..run.kinds import T
from .files import copied_from, key, stand_in, visible

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf")
PARTS_FOLDER = "parts"
SEMANTICS_FOLDER = "semantics"
CLASS_NAMES = "classes.json"  # names of semantic classes by id, beside their masks
EQUIRECTANGULAR = "EQUIRECTANGULAR"  # COLMAP's model of a panorama's camera, with its width and height
_MALFORMED = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, ParseError, csv.Error)


@dataclass(frozen=True)
class Lens:
    """A camera model by COLMAP's name with COLMAP's parameters in pixels, e.g. PINHOLE (fx, fy, cx, cy)."""

    model: str
    parameters: tuple[float, ...]
    face: str = ""  # of a view that is cut out of a panorama, one of `panorama.FACES`


@dataclass(frozen=True)
class Pinhole:
    """Size and intrinsics in pixels of an image without distortion."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class RigView:
    """One photograph as its source describes it."""

    name: str  # path-like name without suffix
    split: str | None  # ``"train"``, ``"held_back"`` or None where the format has no splits
    image: Path  # the photograph, which need not exist
    # width, height: size in pixels that the lens is calibrated for
    width: int
    height: int
    lens: Lens  # intrinsics and distortion
    camera_to_world: np.ndarray  # (4, 4) float64, OpenCV axes, source world
    # parts, semantics: id images that exist, or None
    parts: Path | None = None
    semantics: Path | None = None
    mask: Path | None = None  # image whose black pixels are left out, or None; it need not exist
    missing: str = ""  # where a file does not exist, what was looked for; else ""
    layer: str = ""  # of an EXR with several; see `images.read_radiance`
    colorspace: str = ""  # of the image; "" for what it says


@dataclass(frozen=True, eq=False)
class DepthView:
    """One depth image as its source describes it.

    Attributes:
        path: 16-bit PNG or EXR, depths along the camera's axis; it need not exist.
        width, height: size in pixels that the intrinsics are for.
        fx, fy, cx, cy: pinhole intrinsics in pixels.
        unit: metres per stored unit.
        camera_to_world: (4, 4) float64, OpenCV axes, source world.
        photograph: the view of the same frame, or None.
    """

    path: Path
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    unit: float
    camera_to_world: np.ndarray
    photograph: RigView | None = None


@dataclass(frozen=True, eq=False)
class Rig:
    """A capture as its source describes it.

    Attributes:
        source: name of the format.
        views: all photographs with a pose.
        up_axis: the source axis that points up (see `conventions.UP_AXES`), None where the format does not
            define it.
        mesh: mesh file in the same coordinates as the poses, or None where none was found.
        notes: warnings.
        depths: depth images, from which a mesh can be fused.
        one_camera: whether photographs were assumed to have the depth images' cameras.
    """

    source: str
    views: tuple[RigView, ...]
    up_axis: str | None
    mesh: Path | None
    notes: tuple[Problem, ...] = ()
    depths: tuple[DepthView, ...] = ()
    one_camera: bool = False


def damaged(path: Path, reason: object) -> FiptError:
    """The error for a rig file that does not conform to its format."""
    return stand_in(path) or FiptError("rig-damaged.damaged", path=path, reason=reason)


class WellFormed:
    """Block that reads a rig file: what it raises where the file does not conform becomes ``rig-damaged``."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, _MALFORMED):
            raise damaged(self._path, error) from None


def read_json_rig(path: Path, kind: type[T]) -> T:
    """Read a JSON document that describes cameras; all readers of captures in JSON use this.

    Args:
        path: of the file.
        kind: what it must hold; see `core.run.kinds`.
    """
    try:
        return load_document(path, kind)
    except (OSError, ValueError) as error:
        raise damaged(path, error) from None


def read_pose(path: Path, matrix: Any) -> np.ndarray:
    """A (4, 4) float64 pose from nested lists of 3 or 4 rows."""
    with WellFormed(path):
        values = np.array(matrix, np.float64)
        if values.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"a matrix has shape {values.shape}")
        if len(values) == 4 and values[3, :3].any() and not values[:3, 3].any():
            raise ValueError("a matrix is transposed: its position is in the last row, not the last column")
    pose = np.eye(4)
    pose[:3] = values[:3]
    return pose


def find_mesh(folders: Sequence[Path], stems: Sequence[str]) -> Path | None:
    """The mesh of a capture's room: OBJ, PLY with faces, GLB or glTF.

    Args:
        folders: searched one after another.
        stems: names without suffix, the best first. Without a file of these names, the only mesh in the
            folders is taken; of several, none.
    """
    meshes = {folder: _meshes(folder) for folder in folders}
    for folder, stem in product(folders, stems):
        named = [path for path in meshes[folder] if key(path.stem) == key(stem)]
        if named:
            return min(named, key=lambda path: MESH_SUFFIXES.index(path.suffix.lower()))
    others = {path.resolve(): path for paths in meshes.values() for path in paths}
    names = {(path.parent, key(path.stem)) for path in others.values()}
    plain = [path for path in others.values() if not _is_copy(path, names)]
    return plain[0] if len(plain) == 1 else None


def _is_copy(path: Path, names: set[tuple[Path, str]]) -> bool:
    """Whether a mesh is a second copy of another one, of which folders and stems are given."""
    original = copied_from(path.stem)
    return original != path.stem and (path.parent, key(original)) in names


def _meshes(folder: Path) -> list[Path]:
    """All meshes in a folder, by name."""
    if not folder.is_dir():
        return []
    files = [path for path in visible(folder) if path.suffix.lower() in MESH_SUFFIXES]
    return [path for path in files if path.is_file() and _has_faces(path)]


def _has_faces(path: Path) -> bool:
    """Whether a mesh file has faces by its header: COLMAP's fused.ply is only a point cloud."""
    if path.suffix.lower() != ".ply":
        return True
    with path.open("rb") as file:
        start = file.read(65536)
    if re.search(rb"\nelement[ \t]+(face|tristrips)[ \t]+0*[1-9]", start) is not None:
        return True
    return stand_in(path) is not None  # whoever reads the mesh says what is wrong with it
