"""What the artist knows of surfaces: hints.json and hints_again.json of a run folder, read and written.

Hints are anchored by positions in the world, so that they survive another source of the parts. Standard
library only: both processes import it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

from .documents import read_document
from .errors import FiptError
from .kinds import Vector, choice
from .runfolder import write_json

MOST_HINTS = 1000  # of a document
MOST_POINTS = 500_000  # of all hints together
MOST_NAME = 200  # characters
UNKNOWN, DIELECTRIC, METAL = MATERIALS = ("unknown", "dielectric", "metal")

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
        base_color: scene-linear Rec.709, in (0, 1]; None for unknown. It tells the level and the colour of
            light that no photograph shows.
    """

    points: tuple[Vector, ...]
    name: str = ""
    area: bool = False
    material: Annotated[str, choice(*MATERIALS)] = UNKNOWN
    roughness: tuple[float, float] | None = None
    emits: bool | None = None
    same_as: Vector | None = None
    leave_alone: bool = False
    base_color: Vector | None = None


@dataclass(frozen=True)
class _Hints:
    """hints.json; `light`: see `light_changes`."""

    document: ClassVar[str] = "hints"
    hints: tuple[Hint, ...]
    light: bool = False


def read_hints(path: Path) -> list[Hint]:
    """The hints of a file; none where there is no file."""
    if not path.exists():
        return []
    hints = read_document(path, _Hints, _REMEDY).hints
    if len(hints) > MOST_HINTS or sum(len(hint.points) for hint in hints) > MOST_POINTS:
        raise FiptError("hints-invalid.read-hints", path=path, most_hints=MOST_HINTS, most_points=MOST_POINTS)
    return [_checked(hint, number, path) for number, hint in enumerate(hints, start=1)]


def light_changes(path: Path) -> bool:
    """Whether the light is to be computed anew with the hints of a file."""
    return path.exists() and read_document(path, _Hints, _REMEDY).light


def _checked(hint: Hint, number: int, path: Path) -> Hint:
    """A hint with a name."""
    name = (hint.name or f"Hint {number}")[:MOST_NAME]

    def refuse(problem: str) -> FiptError:
        return FiptError("hints-invalid.refuse", name=name, path=path, problem=problem)

    roughness = hint.roughness
    if not hint.points:
        raise refuse("names no point on a surface")
    if roughness is not None and not 0.0 <= roughness[0] <= roughness[1] <= 1.0:
        raise refuse(f"has the roughness {roughness[0]:g} to {roughness[1]:g}; it must rise within 0 to 1")
    if hint.base_color is not None and not all(0.0 < value <= 1.0 for value in hint.base_color):
        raise refuse("has a base colour that is not above 0 and at most 1")
    return replace(hint, name=name)


def references(hints: Sequence[Hint]) -> list[Hint]:
    """What the light depends on: where hints know the base colour, and that alone."""
    known = [hint for hint in hints if hint.base_color is not None and not hint.leave_alone]
    return [Hint(hint.points, area=hint.area, base_color=hint.base_color) for hint in known]


def write_hints(path: Path, hints: Sequence[Hint], light: bool = False) -> None:
    """Write a file of hints; `light`: see `light_changes`."""
    write_json(path, _Hints(tuple(hints), light))


def hints_digest(hints: Sequence[Hint]) -> str:
    """What the keys of stages hold of hints: "" without any; names do not matter."""
    if not hints:
        return ""
    values = [{**asdict(hint), "name": ""} for hint in hints]
    return hashlib.sha256(repr(values).encode()).hexdigest()
