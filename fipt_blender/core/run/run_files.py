# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Array files of the run folder that both processes read, and readers of those that belong together.

Needs numpy alone. docs/run_folder.md describes the arrays.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .contents import CapturedViews, RoomNames
from .documents import read_document
from .errors import FiptError
from .kinds import T
from .runfolder import RunFolder
from .store import Gaps, optional_arrays, read_arrays

# Names and ids of the objects of what the engine has added to a scan: triangles that close small holes, and
# panes in larger ones with the surfaces that photographs show.
CLOSING = "FIPT Closed Holes"
PANES = "FIPT Panes"
_EXPORT_AGAIN = "Export the room's mesh again (start the estimation again)."


@dataclass(frozen=True, eq=False, kw_only=True)
class RoomArrays:
    """room.npz: V vertices in world metres, T triangles; -1 for no material."""

    vertices: np.ndarray  # (V, 3) f32
    triangles: np.ndarray  # (T, 3) i32, counter-clockwise seen from outside
    corner_normals: np.ndarray  # (T, 3, 3) f32, unit
    triangle_object: np.ndarray  # (T,) i32, of the names in room.json
    triangle_material: np.ndarray  # (T,) i32, likewise
    triangle_polygon: np.ndarray  # (T,) i32, in its object's evaluated mesh
    triangle_exact: np.ndarray | None = None  # (T,) bool, those that are no scan; None without any


@dataclass(frozen=True, eq=False, kw_only=True)
class RoomMesh(RoomArrays, RoomNames):
    """The triangles of all objects of the room, in world space, and their names: room.npz and room.json."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """geometry.npz: what a scan has in place of room.npz."""

    vertices: np.ndarray  # (V, 3) f32
    corner_normals: np.ndarray  # (T, 3, 3) f32
    plane: np.ndarray  # (T,) i32, -1 without one
    noise: float  # metres
    source: np.ndarray  # (32,) u8, `mesh_digest` of what it was made of


@dataclass(frozen=True, eq=False)
class Outlines:
    """outlines.npz: vertices in place of geometry.npz's."""

    vertices: np.ndarray  # (V, 3) f32
    source: np.ndarray  # (32,) u8, digest of those of geometry.npz
    masks: np.ndarray  # (32,) u8, digest of masks and cameras


@dataclass(frozen=True, eq=False)
class AddedSurfaces:
    """closing.npz, with what follows `source`, and panes.npz, with `masks` and `kinds`."""

    vertices: np.ndarray  # (V, 3) f32
    triangles: np.ndarray  # (T, 3) i32
    corner_normals: np.ndarray  # (T, 3, 3) f32
    source: np.ndarray  # (32,) u8, `mesh_digest` of what it was made of
    beside: np.ndarray | None = None  # (T,) i64, the room's triangle at the rim
    most_edges: int | None = None  # the setting `close_holes_edges`
    count: np.ndarray | None = None  # (2,) i32, holes that were closed, and those that stay open
    area: np.ndarray | None = None  # (2,) f32, of these, square metres
    masks: np.ndarray | None = None  # (32,) u8, digest of masks and cameras
    kinds: np.ndarray | None = None  # (3,) bool, of `completion.panes.KINDS`

    @property
    def text(self) -> str:
        """A sentence on the holes of a scan, of closing.npz."""
        assert self.count is not None and self.area is not None
        (closed, left), (closed_area, open_area) = self.count.tolist(), self.area.tolist()
        return (
            f"The scan has {closed:,} small holes, which were closed ({closed_area:.2g} m2), and"
            f" {left:,} large ones, which stay open ({open_area:.2g} m2)."
        )


@dataclass(frozen=True, eq=False)
class AtlasArrays:
    """atlas.npz."""

    corner_uv: np.ndarray  # (T, 3, 2) f32 in [0, 1], V up
    triangle_image: np.ndarray  # (T,) i32 of the images in atlas.json, -1 for none


@dataclass(frozen=True, eq=False)
class CornerFields:
    """textures/corner_fields.npz."""

    base_color: np.ndarray  # (T, 3, 3) f32
    roughness: np.ndarray  # (T, 3) f32
    metallic: np.ndarray  # (T, 3) f32
    confidence: np.ndarray  # (T, 3, 3) f32


@dataclass(frozen=True, eq=False)
class SurveyArrays:
    """survey/survey.npz."""

    seen: np.ndarray  # (views, ceil(T / 8)) u8, a bit for each triangle, the first is the highest
    areas: np.ndarray  # (T,) f32 square metres
    parts: Mapping[str, np.ndarray]  # (T,) i32 for each source, -1 without a part


@dataclass(frozen=True, eq=False)
class PartArrays:
    """results/parts.npz."""

    triangle_part: np.ndarray  # (T,) i32, unit, -1 without one
    single: np.ndarray  # (U,) bool, whether a unit is of one material
    fixed: Gaps | None = None  # (U, 2) f32, roughness and metallic where hints fix them


@dataclass(frozen=True, eq=False)
class Resolution:
    """results/resolution.npz; only where photographs have more pixels than light was solved at."""

    density: Gaps  # (T,) f32 texels a metre


@dataclass(frozen=True, eq=False)
class LeftAlone:
    """results/left_alone.npz; only where the artist has asked for triangles not to be estimated."""

    left_alone: np.ndarray  # (T,) bool


def read_capture(path: Path) -> CapturedViews:
    """capture.json, or ingest.json.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or ``capture-version``.
    """
    return read_document(path, CapturedViews, "Import the capture again.", other="capture-version")


def read_room(run: RunFolder) -> RoomMesh:
    """The run's room.

    What the engine has added to a scan, `CLOSING` and `PANES`, are more objects, the last ones; a room that
    the artist has completed gets none.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    names = read_document(run.room_json, RoomNames, _EXPORT_AGAIN)
    room = RoomMesh(**vars(read_arrays(run.room_npz, RoomArrays, _EXPORT_AGAIN)), **vars(names))
    for name, path in ((CLOSING, run.closing_npz), (PANES, run.panes_npz)):
        added = None if room.completed else read_made(path, AddedSurfaces, mesh_digest(room))
        if added is not None and len(added.triangles):
            room = _with_object(room, name, added)
    corners, count = room.triangles, len(room.vertices)
    if corners.size and not 0 <= corners.min() <= corners.max() < count:  # libraries would read beyond
        raise FiptError("file-damaged.read-room", room_npz=run.room_npz)
    return room


def _with_object(room: RoomMesh, name: str, more: AddedSurfaces) -> RoomMesh:
    """The room with one more object; its triangles have the materials of those `beside` them, if known."""
    count, beside = len(more.triangles), more.beside
    added = {
        "vertices": more.vertices,
        "triangles": more.triangles + len(room.vertices),
        "corner_normals": more.corner_normals,
        "triangle_object": np.full(count, len(room.objects)),
        "triangle_material": np.full(count, -1) if beside is None else room.triangle_material[beside],
        "triangle_polygon": np.arange(count),
        **({} if room.triangle_exact is None else {"triangle_exact": np.zeros(count)}),
    }
    joined: dict[str, Any] = {
        key: np.concatenate([getattr(room, key), values.astype(getattr(room, key).dtype)])
        for key, values in added.items()
    }
    return replace(room, **joined, objects=(*room.objects, name), object_ids=(*room.object_ids, name))


def read_made(path: Path, kind: type[T], source: np.ndarray) -> T | None:
    """An array file that the engine made of what has the digest `source` (32,); None where there is none.

    A damaged one is made again, like one that was made of something else.
    """
    made: Any = optional_arrays(path, kind)
    return made if made is not None and np.array_equal(made.source, source) else None


def read_closing(run: RunFolder) -> AddedSurfaces | None:
    """closing.npz, None where there is none for the run's mesh."""
    mesh = read_arrays(run.room_npz, RoomArrays, _EXPORT_AGAIN)
    return read_made(run.closing_npz, AddedSurfaces, mesh_digest(mesh))


def read_geometry(run: RunFolder, room: RoomArrays) -> Geometry | None:
    """geometry.npz, None where there is none for this room: then the mesh is used as it is."""
    return read_made(run.geometry_npz, Geometry, mesh_digest(room))


def read_outlined(run: RunFolder, room: RoomArrays) -> Geometry | None:
    """geometry.npz with the vertices of outlines.npz, if these fit it; None where the first does not."""
    cleaned = read_geometry(run, room)
    outlines = None if cleaned is None else read_outlines(run, cleaned.vertices)
    return cleaned if cleaned is None or outlines is None else replace(cleaned, vertices=outlines.vertices)


def read_outlines(run: RunFolder, cleaned: np.ndarray) -> Outlines | None:
    """outlines.npz, None where there is none that was made of these vertices (V, 3) of geometry.npz."""
    return read_made(run.outlines_npz, Outlines, array_digest(cleaned))


def array_digest(*arrays: np.ndarray) -> np.ndarray:
    """(32,) uint8 digest of the content of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(digest.digest(), np.uint8)


def mesh_digest(room: RoomArrays) -> np.ndarray:
    """(32,) uint8 digest of a mesh's vertices and triangles, and of which are exact."""
    exact = [] if room.triangle_exact is None else [room.triangle_exact]
    return array_digest(room.vertices.astype(np.float32), room.triangles.astype(np.int32), *exact)
