# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist knows of surfaces: hints.json and hints_again.json of a run folder, read and written.

Hints are anchored by positions in the world, so that they survive another source of the parts. Standard
library only: both processes import it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .documents import Choice, Fields, Items, Maybe, Numbers, head, read_json
from .errors import FiptError
from .runfolder import write_json

MOST_HINTS = 1000  # of a document
MOST_POINTS = 500_000  # of all hints together
MOST_NAME = 200  # characters
UNKNOWN, DIELECTRIC, METAL = MATERIALS = ("unknown", "dielectric", "metal")

Point = tuple[float, float, float]

HINTS = Fields(
    {
        **{key: Choice(value) for key, value in head("hints").items()},
        "hints": Items(
            Fields(
                {"points": Numbers(None, 3)},
                {
                    "name": str,
                    "area": bool,
                    "material": Choice(*MATERIALS),
                    "roughness": Maybe(Numbers(2)),
                    "emits": Maybe(bool),
                    "same_as": Maybe(Numbers(3)),
                    "leave_alone": bool,
                },
            )
        ),
    },
    {"light": bool},
)
_REMEDY = "Correct the file, or set the hints again."


@dataclass(frozen=True)
class Hint:
    """What is known of one part, or of an area that becomes a part of its own.

    Attributes:
        points: on the surface, world metres. A part is the one at the first point; an area has a point on
            each of its triangles.
        name: for messages and the report.
        area: whether the points are an area.
        material: one of `MATERIALS`.
        roughness: lowest and highest sigma; equal where it is known; None for unknown.
        emits: whether it is a lamp; None for unknown.
        same_as: a point on another part that is of the same material, or None.
        leave_alone: not to be estimated: its pixels are left out, its own material stays.
    """

    points: tuple[Point, ...]
    name: str = ""
    area: bool = False
    material: str = UNKNOWN
    roughness: tuple[float, float] | None = None
    emits: bool | None = None
    same_as: Point | None = None
    leave_alone: bool = False


def read_hints(path: Path) -> list[Hint]:
    """The hints of a file; none where there is no file.

    Raises:
        FiptError: ``file-damaged`` or ``hints-invalid``.
    """
    if not path.exists():
        return []
    data = _read(path)["hints"]
    if len(data) > MOST_HINTS or sum(len(entry["points"]) for entry in data) > MOST_POINTS:
        text = f"{path} has more than {MOST_HINTS} hints or {MOST_POINTS} points."
        raise FiptError("hints-invalid", text, "Use fewer or smaller areas.")
    return [_hint(entry, number, path) for number, entry in enumerate(data, start=1)]


def light_changes(path: Path) -> bool:
    """Whether the light is to be computed anew with the hints of a file.

    Raises:
        FiptError: ``file-damaged``.
    """
    return path.exists() and bool(_read(path).get("light", False))


def _read(path: Path) -> dict[str, Any]:
    data: dict[str, Any] = read_json(path, HINTS, _REMEDY)
    return data


def _hint(entry: dict[str, Any], number: int, path: Path) -> Hint:
    name = str(entry.get("name") or f"Hint {number}")[:MOST_NAME]

    def refuse(problem: str) -> FiptError:
        return FiptError("hints-invalid", f"The hint '{name}' in {path} {problem}.", _REMEDY)

    if not entry["points"]:
        raise refuse("names no point on a surface")
    roughness, same_as = entry.get("roughness"), entry.get("same_as")
    if roughness is not None and not 0.0 <= roughness[0] <= roughness[1] <= 1.0:
        raise refuse(f"has the roughness {roughness[0]:g} to {roughness[1]:g}; it must rise within 0 to 1")
    return Hint(
        points=tuple(_point(point) for point in entry["points"]),
        name=name,
        area=entry.get("area", False),
        material=entry.get("material", UNKNOWN),
        roughness=None if roughness is None else (float(roughness[0]), float(roughness[1])),
        emits=entry.get("emits"),
        same_as=None if same_as is None else _point(same_as),
        leave_alone=entry.get("leave_alone", False),
    )


def _point(values: Sequence[float]) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)


def write_hints(path: Path, hints: Sequence[Hint], light: bool = False) -> None:
    """Write a file of hints; `light`: see `light_changes`.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    document = {**head("hints"), "hints": [asdict(hint) for hint in hints]}
    write_json(path, {**document, "light": True} if light else document)


def hints_digest(hints: Sequence[Hint]) -> str:
    """What the keys of stages hold of hints: "" without any; names do not matter."""
    if not hints:
        return ""
    values = [{**asdict(hint), "name": ""} for hint in hints]
    return hashlib.sha256(repr(values).encode()).hexdigest()
