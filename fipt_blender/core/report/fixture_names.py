"""Names of fixtures from what they belong to, where they are and what shape they have: "Ceiling panel".

Objects in Blender and the report have these names, English like those of most captures. Needs numpy alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..run.names import free_name
from ..run.parts import RoomParts, read_parts
from ..run.run_files import read_room
from ..run.runfolder import RunFolder

_LAMPS = frozenset(
    "lamp lamps light lights bulb bulbs lantern chandelier sconce spot spots spotlight spotlights downlight"
    " downlights neon led candle candles fluorescent torchiere screen tv television monitor".split()
)
# Words that say of a lamp no more than that it is one, or of a mesh no more than that it is there.
_BARE = frozenset(
    "lamp light bulb emitter emission emissive area fixture plane cube cylinder sphere circle icosphere mesh"
    " object geometry scan room model part group default material".split()
)
# What a room's whole shell is called, and how one place of it is.
_SHELL = {"wall": "wall", "walls": "wall", "ceiling": "ceiling", "ceilings": "ceiling", "floor": "floor"}
_OWN_SHARE = 0.5  # of an object's area: from there on the object is the lamp
_NEAR = 0.3  # metres between a bulb and the lamp that holds it


class NamedMesh(Protocol):
    """What names are made of: arrays of room.npz and names of room.json (docs/run_folder.md)."""

    @property
    def vertices(self) -> np.ndarray: ...
    @property
    def triangles(self) -> np.ndarray: ...
    @property
    def triangle_object(self) -> np.ndarray: ...
    @property
    def triangle_material(self) -> np.ndarray: ...
    @property
    def objects(self) -> Sequence[str]: ...
    @property
    def materials(self) -> Sequence[str]: ...


class NamedFixture(Protocol):
    """A fixture, of an estimation or of emitters.json."""

    @property
    def triangles(self) -> Sequence[int] | np.ndarray: ...


def run_fixture_names(run: RunFolder, fixtures: Sequence[NamedFixture]) -> list[str]:
    """A name for each fixture of a finished run.

    Args:
        run: its folder.
        fixtures: of emitters.json.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    room = read_room(run)
    return fixture_names(room, fixtures, read_parts(run, room.triangle_object, room.objects))


def fixture_names(
    room: NamedMesh, fixtures: Sequence[NamedFixture], parts: RoomParts | None = None
) -> list[str]:
    """A name for each fixture; equal ones are numbered in the order of the fixtures.

    Args:
        room: the run's room.
        fixtures: their triangles.
        parts: the room's parts, whose semantic classes name a lamp where objects do not.
    """
    names: list[str] = []
    areas = np.linalg.norm(_vector_areas(room, slice(None)), axis=1)
    for fixture in fixtures:
        triangles = np.array(fixture.triangles, np.int64)
        name = _belonging(room, triangles, areas, parts) if len(triangles) else ""
        names.append(free_name(name or "Lamp", names))
    return names


def words(name: str) -> list[str]:
    """A name's words in lower case without numbers: "CeilingPanel_light.001" gives ceiling, panel, light."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return [word.lower() for word in re.findall(r"[^\W\d_]+", parted)]


def _belonging(room: NamedMesh, triangles: np.ndarray, areas: np.ndarray, parts: RoomParts | None) -> str:
    """The name of the lamp's object, material or class where these describe it, else its place and shape."""
    index, share = _main(room.triangle_object, triangles, areas)
    own = words(room.objects[index])
    is_named = bool(_LAMPS & set(own)) or (share >= _OWN_SHARE and not set(own) <= _BARE)
    if not is_named:
        material, _ = _main(room.triangle_material, triangles, areas)
        material_words = words(room.materials[material]) if material >= 0 else []
        if _LAMPS & set(material_words):
            own, is_named = material_words, True
    class_words: list[str] = []
    if parts is not None and not is_named:
        part, _ = _main(parts.triangle, triangles, areas)
        class_words = words(parts.parts[part].class_name or "")
        if _LAMPS & set(class_words):
            own, is_named = class_words, True
    points = room.vertices[np.unique(room.triangles[triangles])].astype(np.float64)
    if is_named and not set(own) <= _BARE:
        return _sentence(own)
    kind = own[-1] if is_named else ""
    holder = _holder(room, index, points)
    if holder:
        return _sentence([*holder, *([kind] if kind and kind not in holder else [])])
    place = _place(room, points, _mean_normal(room, triangles))
    if not is_named and _names_place(room, index, own):
        place = [*own[:-1], _SHELL.get(own[-1], own[-1])]
    elif not is_named and class_words:
        place = [*class_words[:-1], _SHELL.get(class_words[-1], class_words[-1])]
    shape = kind or _shape(points)
    return _sentence([*place, *([shape] if shape != place[-1] else [])])


def _names_place(room: NamedMesh, index: int, own: Sequence[str]) -> bool:
    """Whether an object's name says where in the room it is: "Kitchen walls", not "scan"."""
    if not own or set(own) <= _BARE:
        return False
    corners = room.vertices[np.unique(room.triangles[room.triangle_object == index])]
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    # An object that holds the whole room names no place.
    return own[-1] in _SHELL or diagonal < 0.9 * float(np.linalg.norm(np.ptp(room.vertices, axis=0)))


def _main(owner: np.ndarray, triangles: np.ndarray, areas: np.ndarray) -> tuple[int, float]:
    """The owner (T,) of most of a lamp's area, and the lamp's share of all that this owner has."""
    mine = owner[triangles]
    candidates = np.unique(mine)
    held = [float(areas[triangles[mine == one]].sum()) for one in candidates]
    index = int(candidates[int(np.argmax(held))])
    return index, max(held) / max(float(areas[owner == index].sum()), 1e-12)


def _holder(room: NamedMesh, own: int, points: np.ndarray) -> list[str]:
    """The words of the nearest other object that is a lamp by the last word of its name; [] for none."""
    low, high = points.min(axis=0), points.max(axis=0)
    best: tuple[float, list[str]] = (_NEAR, [])
    for index, name in enumerate(room.objects):
        found = words(name)
        if index == own or not found or found[-1] not in _LAMPS or set(found) <= _BARE:
            continue
        corners = room.vertices[np.unique(room.triangles[room.triangle_object == index])]
        if len(corners):
            gap = np.maximum(np.maximum(corners.min(axis=0) - high, low - corners.max(axis=0)), 0.0)
            best = min(best, (float(np.linalg.norm(gap)), found), key=lambda each: each[0])
    return best[1]


def _place(room: NamedMesh, points: np.ndarray, normal: np.ndarray) -> list[str]:
    """Where a lamp is: at the ceiling, a wall, the floor, on a table, or hanging."""
    low, high = (
        np.asarray(each, np.float64) for each in (room.vertices.min(axis=0), room.vertices.max(axis=0))
    )
    height = max(float(high[2] - low[2]), 1e-6)
    edge = max(0.05 * height, min(0.15, 0.2 * height))
    if high[2] - points[:, 2].max() < edge:
        return ["ceiling"]
    if abs(normal[2]) < 0.5:
        gap = np.minimum(points[:, :2].min(axis=0) - low[:2], high[:2] - points[:, :2].max(axis=0))
        if float(gap.min()) < edge:
            return ["wall"]
    if points[:, 2].min() - low[2] < edge:
        return ["floor"]
    return ["table"] if points[:, 2].mean() - low[2] < 0.55 * height else ["hanging"]


def _shape(points: np.ndarray) -> str:
    """The shape of a lamp by its extents (metres) along the principal axes of its points (P,3)."""
    centered = points - points.mean(axis=0)
    axes = np.linalg.svd(centered, full_matrices=False)[2]
    along = np.sort(np.ptp(centered @ axes.T, axis=0))[::-1]
    length, width, depth = (*along, 0.0, 0.0)[:3]
    if length > 4.0 * width:
        return "strip"
    if depth < 0.15 * width:
        return "panel"
    return "bulb" if length < 0.3 else "lamp"  # metres


def _mean_normal(room: NamedMesh, triangles: np.ndarray) -> np.ndarray:
    """The direction (3,) of a lamp's front, as long as the lamp is plane."""
    vectors = _vector_areas(room, triangles)
    total: np.ndarray = vectors.sum(axis=0) / max(float(np.linalg.norm(vectors, axis=1).sum()), 1e-12)
    return total


def _vector_areas(room: NamedMesh, triangles: np.ndarray | slice) -> np.ndarray:
    corners = room.vertices.astype(np.float64)[room.triangles[triangles]]
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _sentence(found: Sequence[str]) -> str:
    return " ".join(found).capitalize()
