"""The parts of a finished estimate as both processes read them: results/parts.json with results/parts.npz.

Needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .documents import read_document
from .names import free_name
from .result_contents import PartList, RoomPart
from .run_files import PartArrays
from .runfolder import RunFolder
from .store import read_arrays

_AGAIN = "Run the estimation again."
# Parts that get a material of their own; those that fewer pixels saw go with the rest of their objects.
MOST_PARTS = 512
NO_UNIT = -1


@dataclass(frozen=True)
class RoomParts:
    """All parts of a room.

    Attributes:
        triangle: (T,) int32 index into `parts` of each triangle of room.npz.
        parts: those that have triangles.
        source: of the parts, one of `core.parts.labels.choose_parts`; "" where the run does not say.
    """

    triangle: np.ndarray
    parts: list[RoomPart]
    source: str = ""


def read_parts(run: RunFolder, triangle_object: np.ndarray, objects: Sequence[str]) -> RoomParts:
    """The parts of a run; of a run of an earlier version, which does not describe them, the objects.

    Args:
        run: the run folder.
        triangle_object: (T,) object of each triangle of the room.
        objects: their names.
    """
    described: Sequence[RoomPart] = ()
    unit = np.full(len(triangle_object), NO_UNIT, np.int64)
    source = ""
    if run.parts_json.is_file():
        listed = read_document(run.parts_json, PartList, _AGAIN)
        source, described = listed.source, listed.parts
        unit = read_arrays(run.parts_npz, PartArrays, _AGAIN).triangle_part.astype(np.int64)
    return _compact(described, unit, triangle_object, objects, source)


def _compact(
    described: Sequence[RoomPart],
    unit: np.ndarray,
    triangle_object: np.ndarray,
    objects: Sequence[str],
    source: str,
) -> RoomParts:
    """The parts that have triangles, those of few pixels merged into the rest of their objects."""
    pixels = np.array([part.pixels for part in described] or [0])
    kept = np.zeros(len(pixels) + 1, bool)  # the last: no unit
    kept[np.argsort(-pixels, kind="stable")[:MOST_PARTS]] = len(described) > 0
    unit = np.where(unit >= 0, unit, len(pixels))
    # The rest of object i has the number len(pixels) + i.
    number = np.where(kept[unit], unit, len(pixels) + triangle_object)
    used, triangle = np.unique(number, return_inverse=True)
    size = np.bincount(triangle.ravel(), minlength=len(used))
    parts = []
    for index, triangles in zip(used.tolist(), size.tolist(), strict=True):
        if index < len(pixels):
            parts.append(replace(described[index], triangles=triangles))
        else:
            name = objects[index - len(pixels)]
            parts.append(RoomPart(NO_UNIT, f"rest:{name}", readable(name), triangles=triangles))
    names = unique_names([part.name for part in parts])
    named = [replace(part, name=name) for part, name in zip(parts, names, strict=True)]
    return RoomParts(triangle.ravel().astype(np.int32), named, source)


def readable(name: str) -> str:
    """A name of a file's object as a text: spaces in place of underscores, a capital at its beginning."""
    text = " ".join(name.replace("_", " ").split()) or "Surface"
    return text[0].upper() + text[1:]


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, with numbers behind those that occur again."""
    taken: dict[str, None] = {}
    for name in names:
        taken[free_name(name, taken)] = None
    return list(taken)
