"""Reader for RealityScan (RealityCapture): XMP files beside the photographs, or a CSV of camera parameters.

Source: Epic's "XMP Camera Math" and the help page "Internal/External camera parameters". The principal point
is divided by the photograph's longer side, the focal length is that for a film of 36 mm. The distortion is
OpenCV's with t1 = p2 and t2 = p1.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ...alignment.turns import turn_by
from ...conventions import opengl_to_opencv_camera
from ...run.errors import Problem, problem
from ..files import Folders
from ..options import CaptureOptions
from ..places import IMAGE_FOLDERS, Places
from ..rig import Lens, Rig, RigView, WellFormed
from .radial import distorting_lens
from .rig_files import (
    camera_file,
    camera_files,
    camera_pose,
    cameras_off,
    head,
    number,
    numbers,
    read_text_rig,
    read_xml_rig,
    unsupported,
)

NAME = "realityscan"
LOOKS_FOR = (
    "XMP files with xcr:Position beside the photographs, or a CSV file with the columns x, y, alt, heading, f"
)
FOLDERS = (".", "images", "input")
_XCR = "{http://www.capturingreality.com/ns/xcr/1.1#}"
_COLUMNS = ("x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
# What RealityScan 2 calls columns.
_NEW_NAMES = {"yaw": "heading", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}
_XMP_IMAGES = tuple(dict.fromkeys((*IMAGE_FOLDERS, *FOLDERS)))


def find(path: Path) -> tuple[Path, list[Path]] | None:
    """A folder and the camera files in it, None without: the CSV file, or the XMP files beside photographs.

    These are the ones of the first folder that has any with a pose, otherwise all in the folders below.
    """
    table = camera_file(path, (".csv",), _is_camera_table)
    if table is not None:
        return table.parent, [table]
    posed = next((file for file in camera_files(path, (".xmp",), FOLDERS) if _has_pose(file)), None)
    if posed is not None:
        return posed.parent, list(camera_files(posed.parent, (".xmp",)))
    below = Folders().files(path, ".xmp")
    return (path, below) if any(_has_pose(file) for file in below) else None


def read(found: tuple[Path, list[Path]], options: CaptureOptions) -> Rig:
    """Read all cameras of a CSV file, or of XMP files. The world is Z up.

    Sizes are those of the photographs, since the files have none.
    """
    folder, files = found
    notes: tuple[Problem, ...] = ()
    if files[0].suffix.lower() == ".csv":
        places = Places.around(files[0], options)
        views = _csv_views(files[0], places)
    else:
        places = Places.around(folder / files[0].name, options, _XMP_IMAGES)
        views, notes = _xmp_views(folder, files, places)
    views.sort(key=lambda view: view.name)
    return places.rig(NAME, views, "z", places.mesh(), notes)


def _is_camera_table(text: str) -> bool:
    columns = text.split("\n", 1)[0].strip().split(",")
    return columns[0].strip() == "#name" and set(_COLUMNS[:7]) <= {_column(column) for column in columns}


def _column(name: str) -> str:
    return _NEW_NAMES.get(name.strip(), name.strip())


def _has_pose(file: Path) -> bool:
    text = head(file)
    return "capturingreality.com/ns/xcr" in text and "Position" in text and "Rotation" in text


def _csv_views(file: Path, places: Places) -> list[RigView]:
    views = []
    with WellFormed(file):
        for entries in csv.DictReader(read_text_rig(file).splitlines(), skipinitialspace=True):
            row = {_column(key): value for key, value in entries.items()}
            values = {key: number(row[key]) for key in _COLUMNS}
            name = str(row["#name"])
            size = places.size(name)
            angles = (values["heading"], values["pitch"], values["roll"])
            pose = camera_pose(_world_to_camera(*angles), np.array([values["x"], values["y"], values["alt"]]))
            coefficients = tuple(values[key] for key in _COLUMNS[9:])
            lens = _lens(size, (values["f"], values["px"], values["py"]), coefficients)
            views.append(places.view(name, size, lens, opengl_to_opencv_camera(pose)))
    return views


def _world_to_camera(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation (3, 3) to OpenGL camera axes of angles in degrees; at zero the camera looks straight down."""
    x, y, z = np.diag(np.radians([pitch, roll, -heading]))
    return (turn_by(z) @ turn_by(x) @ turn_by(y)).T


def _xmp_views(folder: Path, files: list[Path], places: Places) -> tuple[list[RigView], tuple[Problem, ...]]:
    """The views of all XMP files with a pose, and a warning of those that RealityScan could not align.

    Files of other programs are left alone; a damaged one is refused, since its view would be missing.
    """
    values = [_xmp_values(file) for file in files]
    posed = [bool({f"{_XCR}Rotation", f"{_XCR}Position"} & found.keys()) for found in values]
    all_files = list(zip(files, values, posed, strict=True))
    off = [file for file, found, use in all_files if use and found.get(f"{_XCR}InTexturing") == "0"]
    names = {file: file.relative_to(folder).with_suffix("").as_posix() for file in files}
    views = [
        _xmp_view(file, names[file], found, places)
        for file, found, use in all_files
        if use and file not in off
    ]
    lost = [file for file, found, use in all_files if found and not use]
    notes = cameras_off(folder, [file.name for file in off])
    for file in (*off, *lost):
        places.find(names[file])  # it is told of here, and not as one without a camera
    if not lost:
        return views, notes
    return views, (*notes, problem("pose-lost.xmp-views", number_of_lost=len(lost), lost=lost[0]))


def _xmp_values(file: Path) -> dict[str, str]:
    """RealityScan's values in an XMP file, which are attributes or elements."""
    values: dict[str, str] = {}
    for element in read_xml_rig(file).iter():
        values.update({key: value for key, value in element.attrib.items() if key.startswith(_XCR)})
        if element.tag.startswith(_XCR):
            values[element.tag] = (element.text or "").strip()
    return values


def _xmp_view(file: Path, name: str, values: dict[str, str], places: Places) -> RigView:
    """The view of a name that an XMP file's values describe."""
    with WellFormed(file):
        rotation = numbers(values[f"{_XCR}Rotation"], 9).reshape(3, 3)
        centre = numbers(values[f"{_XCR}Position"], 3)
        film = tuple(
            number(values.get(_XCR + key, "0"))
            for key in ("FocalLength35mm", "PrincipalPointU", "PrincipalPointV")
        )
        coefficients = numbers(values.get(f"{_XCR}DistortionCoeficients", "0 0 0 0 0 0"), 6)
        skew = number(values.get(f"{_XCR}Skew", "0"))
        aspect = number(values.get(f"{_XCR}AspectRatio", "1"))
    model = values.get(f"{_XCR}DistortionModel", "brown3")
    known = model.startswith("brown") or model == "perspective" or not coefficients.any()
    if skew != 0.0 or aspect != 1.0 or not known:
        what = f"the distortion model {model[:40]!r}, skew {skew:g} and aspect ratio {aspect:g}"
        remedy = "Align again with a Brown distortion model without K + (Alignment Settings > Advanced)."
        raise unsupported(file, what, remedy)
    size = places.size(name)
    lens = _lens(size, film, tuple(float(value) for value in coefficients))
    return places.view(name, size, lens, camera_pose(rotation, centre))


def _lens(size: tuple[int, int], film: tuple[float, ...], coefficients: tuple[float, ...]) -> Lens:
    """The lens of a photograph.

    Args:
        size: width and height in pixels.
        film: focal length in mm of 36 mm film, and the principal point's offsets from the centre.
        coefficients: k1 to k4, t1, t2.
    """
    side = float(max(size))
    focal = film[0] * side / 36.0  # mm, of 35 mm film
    intrinsics = (focal, focal, 0.5 * size[0] + film[1] * side, 0.5 * size[1] + film[2] * side)
    return distorting_lens(intrinsics, size, coefficients[:4], (coefficients[5], coefficients[4]))
