# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
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

from ...run.errors import FiptError
from ...run.shapes import FARTHEST_UNITS
from ..files import visible
from ..options import CaptureOptions
from ..rig import Note, Rig, damaged
from ..suffixes import SUFFIXES
from . import colmap, datasets, json_solves, realityscan, scans, text_solves, transforms, xml_solves
from .rig_files import Program

MOST_FOLDERS = 200  # that are searched for a capture below one that is none
# Formats of data sets, which contain files of other formats, too.
COMPLETE = tuple(each.NAME for each in datasets.SETS)
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
    """The name of the first format that matches a capture.

    Raises:
        FiptError: ``capture-missing``; ``capture-elsewhere``; ``cameras-missing`` for photographs alone;
            ``format-unknown``.
    """
    if not path.exists():
        raise FiptError("capture-missing", f"The capture {path} does not exist.", "Correct the path.")
    for name, module in FORMATS.items():
        if module.find(path) is not None:
            return name
    folder = path if path.is_dir() else path.parent
    if (near := _capture_near(folder)) is not None:
        raise FiptError(
            "capture-elsewhere",
            f"{path} is no capture, but {near[0]} is one, in the format {near[1]}.",
            f"Choose the folder {near[0]}.",
        )
    files = (file for pattern in ("*", "*/*") for file in folder.glob(pattern))
    if any(file.suffix.lower() in SUFFIXES for file in islice(files, 10_000)):
        raise FiptError(
            "cameras-missing",
            f"{folder} holds photographs without cameras.",
            "Make a capture of them: Photographs > Make Capture in Blender, or the command prepare.",
        )
    raise FiptError(
        "format-unknown",
        f"{path} holds neither photographs nor cameras in a known format ({', '.join(FORMATS)}).",
        "Choose the folder that contains the camera file and the photographs.",
    )


def _capture_near(folder: Path) -> tuple[Path, str] | None:
    """A capture in a folder or at most two folders below it, and its format."""
    below = (each for pattern in ("*", "*/*") for each in sorted(folder.glob(pattern)) if each.is_dir())
    for place in (folder, *islice(below, MOST_FOLDERS)):
        for name, module in FORMATS.items():
            if module.find(place) is not None:
                return place, name
    return None


def _others(path: Path, used: str) -> Note | None:
    """A note of other formats in which a capture could be read."""
    also = [name for name, module in FORMATS.items() if name != used and module.find(path) is not None]
    if not also or used in COMPLETE:
        return None
    return Note(
        "formats-several",
        f"{path} is read in the format {used}; it could be read as {' or '.join(also)}, too.",
        f"If cameras or mesh are wrong, choose the other format (--format {also[0]}).",
    )


def read_rig(path: Path, name: str, options: CaptureOptions) -> Rig:
    """Read a capture; `name` is one of `FORMATS` or "auto".

    Raises:
        FiptError: ``capture-missing``, ``cameras-missing``, ``format-unknown``, ``capture-unreadable`` where
            the system refuses access, or one of the reader's.
    """
    try:
        return _read_rig(path, name, options)
    except OSError as error:
        remedy = "Allow your user to read the capture's files and folders, or copy them to your own disk."
        if error.errno == errno.ENAMETOOLONG:
            remedy = "Correct the name, or move the capture to a folder with a shorter path."
        raise FiptError(
            "capture-unreadable",
            f"{str(error.filename or path)[:1000]} can't be read ({error.strerror}).",
            remedy,
        ) from None


def read_points(path: Path, name: str, sure: bool = False) -> np.ndarray:
    """The sparse points (N, 3) float64 of a capture's solve, in the coordinates of its poses.

    Args:
        path: of the capture.
        name: of its format, one of `FORMATS`.
        sure: only the better ones, where the format distinguishes them.

    Raises:
        FiptError: ``alignment-points`` where the format has none, or one of the reader's.
    """
    module = FORMATS[name]
    reader = getattr(module, "points", None)
    if sure:
        reader = getattr(module, "sure_points", reader)
    if reader is None:
        raise FiptError(
            "alignment-points",
            f"The format {name} holds no sparse points, by which cameras could be aligned.",
            "Align by pairs of points alone, or export the cameras as a COLMAP model with points.",
        )
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
        raise FiptError("capture-missing", f"The capture {path} does not exist.", "Correct the path.")
    found = module.find(path)
    if found is None:
        raise FiptError(
            "format-unknown",
            f"{path} is not a capture in the format {name}, which needs {module.LOOKS_FOR}.",
            "Set the format to auto, or choose another folder.",
        )
    rig: Rig = module.read(found, options)
    notes = [_others(path, detected) if name == "auto" else None, _other_files(path, found, module)]
    return replace(rig, notes=(*rig.notes, *filter(None, notes)))


def _other_files(path: Path, found: Any, module: Reader) -> Note | None:
    """A note of other camera files of the same program in the folder that was chosen."""
    if path.is_file() or not isinstance(found, Path) or not found.is_file():
        return None
    beside = [file for file in visible(found.parent) if file.suffix == found.suffix and file != found]
    also = [str(file) for file in beside if module.find(file) is not None]
    if not also:
        return None
    text = f"{found} is read; {len(also)} other files hold such cameras, too: {', '.join(also[:3])}."
    return Note("formats-several", text, "To read another one, choose that file instead of the folder.")
