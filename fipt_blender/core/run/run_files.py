# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the run folder that both processes read, with the checks that need more than one of their values.

Needs numpy alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .arrays import read_arrays
from .documents import read_json
from .errors import FiptError
from .runfolder import RunFolder
from .shapes import ATLAS, ATLAS_ARRAYS, CAPTURE, EMITTERS, ROOM, ROOM_ARRAYS

_EXPORT_AGAIN = "Export the room's mesh again (start the estimation again)."
_ATLAS_AGAIN = "Start the run again without --resume, or apply the results again."
_ESTIMATE_AGAIN = "Run the estimation again."


def read_capture(path: Path) -> dict[str, Any]:
    """capture.json, or ingest.json.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    return read_json(path, CAPTURE, "Import the capture again.")


def read_room_files(
    run: RunFolder, code: str = "file-damaged"
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays of room.npz, and room.json; indices are within their ranges.

    Args:
        run: the run folder.
        code: of the error for damaged arrays.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or `code`.
    """
    names = read_json(run.room_json, ROOM, _EXPORT_AGAIN)
    if len(names.get("object_ids") or names["objects"]) != len(names["objects"]):
        raise FiptError("file-damaged", f"{run.room_json} has not one id per object.", _EXPORT_AGAIN)
    arrays = read_arrays(run.room_npz, ROOM_ARRAYS, code, _EXPORT_AGAIN)
    ranges = (
        ("triangles", 0, len(arrays["vertices"]), "vertices"),
        ("triangle_object", 0, len(names["objects"]), "objects"),
        ("triangle_material", -1, len(names["materials"]), "materials"),
        ("triangle_polygon", 0, np.iinfo(np.int32).max, "polygons"),
    )
    for name, low, end, what in ranges:
        if not _within(arrays[name], low, end):
            text = f"The room's mesh in {run.room_npz} refers to missing {what}."
            raise FiptError(code, text, _EXPORT_AGAIN)
    return arrays, names


def read_atlas(run: RunFolder, triangles: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """atlas.json, and the arrays of atlas.npz.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    atlas = read_json(run.atlas_json, ATLAS, _ATLAS_AGAIN)
    arrays = read_arrays(run.atlas_npz, ATLAS_ARRAYS, remedy=_ATLAS_AGAIN)
    image = arrays["triangle_image"]
    is_uv = atlas["mode"] == "uv"  # colour attributes need no images
    if len(image) != triangles or (is_uv and not _within(image, -1, len(atlas["images"]))):
        raise FiptError(
            "file-damaged", f"{run.atlas_npz} does not fit the room and {run.atlas_json}.", _ATLAS_AGAIN
        )
    return atlas, arrays


def read_emitters(run: RunFolder, triangles: int) -> dict[str, Any]:
    """emitters.json.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    data = read_json(run.emitters_json, EMITTERS, _ESTIMATE_AGAIN)
    if any(max(fixture["triangles"], default=-1) >= triangles for fixture in data["fixtures"]):
        raise FiptError(
            "file-damaged", f"{run.emitters_json} names triangles that the room lacks.", _ESTIMATE_AGAIN
        )
    return data


def _within(values: np.ndarray, low: int, end: int) -> bool:
    """Whether all indices lie in low <= index < end."""
    return not values.size or bool(values.min() >= low and values.max() < end)
