"""Array files of the run folder that both processes read, and readers of those that belong together.

Needs numpy alone. docs/run_folder.md describes the arrays.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .contents import CapturedViews, RoomNames
from .documents import read_document
from .errors import FiptError
from .runfolder import RunFolder
from .store import Gaps, read_arrays

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


@dataclass(frozen=True, eq=False)
class Geometry:
    """The cleaned geometry of a scan, in place of the room's."""

    vertices: np.ndarray  # (V, 3) f32
    corner_normals: np.ndarray  # (T, 3, 3) f32
    plane: np.ndarray  # (T,) i32, -1 without one
    noise: float  # metres


@dataclass(frozen=True, eq=False, kw_only=True)
class RoomMesh(RoomArrays, RoomNames):
    """The triangles of all objects of the room, in world space, and their names: room.npz and room.json."""

    scan: Geometry | None = None  # of results/scan.npz; None where the mesh is no scan


@dataclass(frozen=True, eq=False)
class AddedSurfaces:
    """Triangles that the engine adds to a scan as one object."""

    vertices: np.ndarray  # (V, 3) f32
    triangles: np.ndarray  # (T, 3) i32
    corner_normals: np.ndarray  # (T, 3, 3) f32
    beside: np.ndarray | None = None  # (T,) i64, the room's triangle at the rim, whose material they have


@dataclass(frozen=True, eq=False)
class ScanArrays(Geometry):
    """results/scan.npz: what an estimation has made of a scan in room.npz."""

    source: np.ndarray  # (32,) u8, `mesh_digest` of that
    closing: Mapping[str, np.ndarray] = field(default_factory=dict)  # of `AddedSurfaces`, `CLOSING`
    panes: Mapping[str, np.ndarray] = field(default_factory=dict)  # likewise, `PANES`

    def whole(self, room: RoomMesh) -> RoomMesh:
        """The room with what was added to it, and its geometry."""
        closing, panes = (AddedSurfaces(**each) if each else None for each in (self.closing, self.panes))
        geometry = Geometry(self.vertices, self.corner_normals, self.plane, float(self.noise))
        return replace(with_added(room, closing, panes), scan=geometry)


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
    """capture.json, or ingest.json."""
    return read_document(path, CapturedViews, "Import the capture again.", other="capture-version")


def read_room(run: RunFolder) -> RoomMesh:
    """The run's room, with what the last estimation has made of it where it is a scan.

    What the engine has added, `CLOSING` and `PANES`, are more objects, the last ones.
    """
    room = read_exported(run)
    if run.scan_npz.exists():
        scan = read_arrays(run.scan_npz, ScanArrays)
        if np.array_equal(scan.source, mesh_digest(room)):
            room = scan.whole(room)
    return room


def read_exported(run: RunFolder) -> RoomMesh:
    """The room as Blender has written it: room.npz and room.json."""
    names = read_document(run.room_json, RoomNames, _EXPORT_AGAIN)
    room = RoomMesh(**vars(read_arrays(run.room_npz, RoomArrays, _EXPORT_AGAIN)), **vars(names))
    corners, count = room.triangles, len(room.vertices)
    if corners.size and not 0 <= corners.min() <= corners.max() < count:  # libraries would read beyond
        raise FiptError("file-damaged.read-room", room_npz=run.room_npz)
    return room


def with_added(room: RoomMesh, closing: AddedSurfaces | None, panes: AddedSurfaces | None) -> RoomMesh:
    """The room with what the engine has added to it: more objects, the last ones."""
    for name, added in ((CLOSING, closing), (PANES, panes)):
        if added is not None and len(added.triangles):
            room = _with_object(room, name, added)
    return room


def scan_arrays(
    room: RoomMesh, closing: AddedSurfaces | None, panes: AddedSurfaces | None, geometry: Geometry
) -> ScanArrays:
    """What results/scan.npz holds of a room in room.npz."""
    added = [
        {}
        if each is None or not len(each.triangles)
        else {k: v for k, v in vars(each).items() if v is not None}
        for each in (closing, panes)
    ]
    return ScanArrays(**vars(geometry), source=mesh_digest(room), closing=added[0], panes=added[1])


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


def mesh_digest(room: RoomMesh) -> np.ndarray:
    """(32,) uint8 digest of a mesh's vertices and triangles, which are exact, and whether it is completed."""
    arrays = [room.vertices.astype(np.float32), room.triangles.astype(np.int32), np.array(room.completed)]
    digest = hashlib.sha256()
    for array in [*arrays, *([] if room.triangle_exact is None else [room.triangle_exact])]:
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(digest.digest(), np.uint8)
