"""The registry of capture formats.

Each is a module, a `Program`, or an app of `scans`, with NAME and LOOKS_FOR; `find(path)`, what a capture is
read from, or None where it has another format; `read(found, options)`; and, if it holds points,
`points(found)`, perhaps `sure_points`.
"""

from __future__ import annotations

import errno
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...run.errors import FiptError, Problem, problem
from ...run.shapes import FARTHEST_UNITS
from ..files import visible
from ..options import CaptureOptions
from ..rig import Rig, damaged
from ..suffixes import SUFFIXES
from . import colmap, datasets, json_solves, realityscan, scans, text_solves, transforms, xml_solves
from .rig_files import Program, head

MOST_FOLDERS = 200  # that are searched for a capture below one that is none
# Formats of data sets, which contain files of other formats, too.
COMPLETE = tuple(each.NAME for each in datasets.SETS)
_CONVERT = "Convert it to transforms.json, or to a COLMAP model"
_NO_LENS = f"{_CONVERT}, with the camera's lens, which this file does not have."
_SOLVE = f"Choose the COLMAP model that it was made of. {_CONVERT}, if there is none."
# Files of poses that are not read: pattern, a word in their beginning, what they are, and what to do.
OTHER_POSES = (
    ("poses_bounds.npy", "", "the poses of LLFF", _SOLVE),
    ("groundtruth.txt", "", "a trajectory of the TUM benchmark or of a SLAM program", _NO_LENS),
    ("traj*.txt", "", "a trajectory of a SLAM program", _NO_LENS),
    ("*[Tt]rajectory*.txt", "", "a trajectory of a SLAM program", _NO_LENS),
    ("poses.txt", "", "a trajectory of a SLAM program", _NO_LENS),
    ("cameras.json", '"img_name"', "the cameras beside a model of 3D Gaussians", _SOLVE),
    ("cameras*.npz", "", "cameras of NeuS or IDR", _SOLVE),
    ("camera_path*.json", "", "a path for renders, not cameras of photographs", _SOLVE),
    ("*.cam", "", "a camera of MVE or MVSNet", _SOLVE),
    ("*.p4p", "", "a project of Pix4D", "Export its cameras: BlocksExchange, Bundler or COLMAP."),
    ("*.psx", "", "a project of Metashape", "Export its cameras: File > Export > Export Cameras, as XML."),
    ("*.rsproj", "", "a project of RealityScan", "Export its registration, as COLMAP or CSV."),
    ("*.rcproj", "", "a project of RealityScan", "Export its registration, as COLMAP or CSV."),
)
Reader = ModuleType | Program | datasets.DataSet | scans.ScanApp
# The first match is used: nerfstudio, for example, keeps a COLMAP model beside its transforms.json.
FORMATS: dict[str, Reader] = {
    each.NAME: each
    for each in (
        *datasets.SETS,
        transforms,
        colmap,
        *xml_solves.PROGRAMS,
        realityscan,
        *json_solves.PROGRAMS,
        *text_solves.PROGRAMS,
        *scans.APPS,
    )
}


def detect_format(path: Path) -> str:
    """The name of the first format that matches a capture."""
    if not path.exists():
        raise FiptError("capture-missing.detect-format", path=path)
    for name, module in FORMATS.items():
        if module.find(path) is not None:
            return name
    folder = path if path.is_dir() else path.parent
    if (near := _capture_near(folder)) is not None:
        raise FiptError("capture-elsewhere", path=path, near=near[0], near_2=near[1])
    files = (file for pattern in ("*", "*/*") for file in folder.glob(pattern))
    has_photographs = any(file.suffix.lower() in SUFFIXES for file in islice(files, 10_000))
    for pattern, word, what, remedy in OTHER_POSES:
        for file in sorted(folder.glob(pattern)):
            if file.is_file() and word in head(file):
                raise FiptError("cameras-other", file=file, what=what, remedy=remedy)
    if has_photographs:
        raise FiptError("cameras-missing", folder=folder)
    raise FiptError("format-unknown.detect-format", path=path, formats=", ".join(FORMATS))


def _capture_near(folder: Path) -> tuple[Path, str] | None:
    """A capture in a folder or at most two folders below it, and its format."""
    below = (each for pattern in ("*", "*/*") for each in sorted(folder.glob(pattern)) if each.is_dir())
    for place in (folder, *islice(below, MOST_FOLDERS)):
        for name, module in FORMATS.items():
            if module.find(place) is not None:
                return place, name
    return None


def _others(path: Path, used: str) -> Problem | None:
    """A note of other formats in which a capture could be read."""
    also = [name for name, module in FORMATS.items() if name != used and module.find(path) is not None]
    if not also or used in COMPLETE:
        return None
    return problem("formats-several.others", path=path, used=used, also=" or ".join(also), also_2=also[0])


def read_rig(path: Path, name: str, options: CaptureOptions) -> Rig:
    """Read a capture; `name` is one of `FORMATS` or "auto"."""
    try:
        return _read_rig(path, name, options)
    except OSError as error:
        remedy = "Allow your user to read the capture's files and folders, or copy them to your own disk."
        if error.errno == errno.ENAMETOOLONG:
            remedy = "Correct the name, or move the capture to a folder with a shorter path."
        raise FiptError(
            "capture-unreadable",
            filename=str(error.filename or path)[:1000],
            strerror=error.strerror,
            remedy=remedy,
        ) from None


def read_points(path: Path, name: str, sure: bool = False) -> np.ndarray:
    """The sparse points (N, 3) float64 of a capture's solve, in the coordinates of its poses.

    Args:
        path: of the capture.
        name: of its format, one of `FORMATS`.
        sure: only the better ones, where the format distinguishes them.
    """
    module = FORMATS[name]
    reader = getattr(module, "points", None)
    if sure:
        reader = getattr(module, "sure_points", reader)
    if reader is None:
        raise FiptError("alignment-points.read-points", name=name)
    found = module.find(path)
    if found is None:
        raise damaged(path, f"it lacks {module.LOOKS_FOR}")
    points: np.ndarray = reader(found)
    # Solves have single points at infinity; in no unit are they farther away than this.
    return points[(np.abs(points) <= FARTHEST_UNITS).all(axis=1)]


def _read_rig(path: Path, name: str, options: CaptureOptions) -> Rig:
    detected = detect_format(path) if name == "auto" else name
    module = FORMATS[detected]
    if not path.exists():
        raise FiptError("capture-missing.detect-format", path=path)
    found = module.find(path)
    if found is None:
        raise FiptError("format-unknown.read-rig", path=path, name=name, looks_for=module.LOOKS_FOR)
    rig: Rig = module.read(found, options)
    notes = [_others(path, detected) if name == "auto" else None, _other_files(path, found, module)]
    return replace(rig, notes=(*rig.notes, *filter(None, notes)))


def _other_files(path: Path, found: Any, module: Reader) -> Problem | None:
    """A note of other camera files of the same program in the folder that was chosen."""
    if path.is_file() or not isinstance(found, Path) or not found.is_file():
        return None
    beside = [file for file in visible(found.parent) if file.suffix == found.suffix and file != found]
    also = [str(file) for file in beside if module.find(file) is not None]
    if not also:
        return None
    return problem(
        "formats-several.other-files", found=found, number_of_also=len(also), also=", ".join(also[:3])
    )
