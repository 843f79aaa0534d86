# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Array files of the run folder that both processes read, and readers of those that belong together.

Needs numpy alone. docs/run_folder.md describes the arrays.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from .contents import CapturedViews, RoomNames
from .documents import read_document
from .errors import FiptError
from .kinds import T
from .result_contents import AtlasImages, Emitters
from .runfolder import RunFolder
from .store import Array, optional_arrays, read_arrays

# Names and ids of the objects of what the engine has added to a scan: triangles that close small holes, and
# panes in larger ones with the surfaces that photographs show.
CLOSING = "FIPT Closed Holes"
PANES = "FIPT Panes"
_EXPORT_AGAIN = "Export the room's mesh again (start the estimation again)."
_ATLAS_AGAIN = "Start the run again without --resume, or apply the results again."
_ESTIMATE_AGAIN = "Run the estimation again."

_Points = Annotated[np.ndarray, Array("f", "vertices", 3)]
_Corners = Annotated[np.ndarray, Array("i", "triangles", 3, below="vertices")]
_Normals = Annotated[np.ndarray, Array("f", "triangles", 3, 3)]
_Digest = Annotated[np.ndarray, Array("i", 32)]  # of what a file was made of


@dataclass(frozen=True, eq=False)
class RoomArrays:
    """room.npz."""

    vertices: _Points
    triangles: _Corners
    corner_normals: _Normals
    triangle_object: Annotated[np.ndarray, Array("i", "triangles", below="objects")]
    triangle_material: Annotated[np.ndarray, Array("i", "triangles", below="materials", least=-1)]
    triangle_polygon: Annotated[np.ndarray, Array("i", "triangles", below="polygons")]
    triangle_exact: Annotated[np.ndarray | None, Array("b", "triangles")] = None


# Those that every room has.
ROOM_ARRAYS = tuple(item.name for item in fields(RoomArrays) if item.name != "triangle_exact")


@dataclass(frozen=True, eq=False)
class Geometry:
    """geometry.npz."""

    vertices: _Points
    corner_normals: _Normals
    plane: Annotated[np.ndarray, Array("i", "triangles")]
    noise: Annotated[float, Array("f")]
    source: _Digest


@dataclass(frozen=True, eq=False)
class Outlines:
    """outlines.npz."""

    vertices: _Points
    source: _Digest
    masks: _Digest


@dataclass(frozen=True, eq=False)
class AddedSurfaces:
    """closing.npz, with what follows `source`, and panes.npz, with `masks` and `kinds`."""

    vertices: _Points
    triangles: _Corners
    corner_normals: _Normals
    source: _Digest
    beside: Annotated[np.ndarray | None, Array("i", "triangles", below="triangles of the room")] = None
    most_edges: Annotated[int | None, Array("i")] = None
    count: Annotated[np.ndarray | None, Array("i", 2)] = None
    area: Annotated[np.ndarray | None, Array("f", 2)] = None
    masks: Annotated[np.ndarray | None, Array("i", 32)] = None
    kinds: Annotated[np.ndarray | None, Array("b", 3)] = None

    @property
    def holes(self) -> ScanHoles | None:
        """What closing.npz says of a scan's holes."""
        if self.most_edges is None or self.count is None or self.area is None:
            return None
        (closed, left), (closed_area, open_area) = self.count.tolist(), self.area.tolist()
        return ScanHoles(closed, left, closed_area, open_area, int(self.most_edges))


@dataclass(frozen=True)
class ScanHoles:
    """The holes of a scan.

    Attributes:
        closed, left: how many small ones were closed, and how many stay open.
        closed_area, open_area: square metres.
        most_edges: the setting `close_holes_edges`.
    """

    closed: int
    left: int
    closed_area: float
    open_area: float
    most_edges: int

    @property
    def text(self) -> str:
        """A sentence for the user."""
        return (
            f"The scan has {self.closed:,} small holes, which were closed ({self.closed_area:.2g} m2), and"
            f" {self.left:,} large ones, which stay open ({self.open_area:.2g} m2)."
        )


@dataclass(frozen=True, eq=False)
class AtlasArrays:
    """atlas.npz."""

    corner_uv: Annotated[np.ndarray, Array("f", "triangles", 3, 2)]
    triangle_image: Annotated[np.ndarray, Array("i", "triangles", below="images", least=-1)]


@dataclass(frozen=True, eq=False)
class CornerFields:
    """textures/corner_fields.npz."""

    base_color: _Normals
    roughness: Annotated[np.ndarray, Array("f", "triangles", 3)]
    metallic: Annotated[np.ndarray, Array("f", "triangles", 3)]
    confidence: _Normals


@dataclass(frozen=True, eq=False)
class SurveyArrays:
    """survey/survey.npz."""

    seen: Annotated[np.ndarray, Array("i", "views", "bytes")]
    areas: Annotated[np.ndarray, Array("f", "triangles")]
    parts: Annotated[Mapping[str, np.ndarray], Array("i", "triangles")]


@dataclass(frozen=True, eq=False)
class PartArrays:
    """results/parts.npz; `fixed`: roughness and metallic where hints fix them."""

    triangle_part: Annotated[np.ndarray, Array("i", "triangles", below="units", least=-1)]
    single: Annotated[np.ndarray, Array("b", "units")]
    fixed: Annotated[np.ndarray | None, Array("u", "units", 2)] = None


@dataclass(frozen=True, eq=False)
class Resolution:
    """results/resolution.npz; only where photographs have more pixels than light was solved at."""

    density: Annotated[np.ndarray, Array("u", "triangles")]


@dataclass(frozen=True, eq=False)
class LeftAlone:
    """results/left_alone.npz; only where the artist has asked for triangles not to be estimated."""

    left_alone: Annotated[np.ndarray, Array("b", "triangles")]


def read_capture(path: Path) -> CapturedViews:
    """capture.json, or ingest.json.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or ``capture-version``.
    """
    return read_document(path, CapturedViews, "Import the capture again.", other="capture-version")


def read_room_files(run: RunFolder, code: str = "file-damaged") -> tuple[dict[str, np.ndarray], RoomNames]:
    """The arrays of room.npz, and room.json; indices are within their ranges.

    What the engine has added to a scan, `CLOSING` and `PANES`, are more objects, the last ones; a room that
    the artist has completed gets none. Surfaces that are no scan are those of `triangle_exact`, (T,) bool, if
    there are any.

    Args:
        run: the run folder.
        code: of the error for damaged arrays.

    Raises:
        FiptError: ``file-missing``, ``file-damaged`` or `code`.
    """
    names = read_document(run.room_json, RoomNames, _EXPORT_AGAIN)
    if len(names.ids) != len(names.objects):
        raise FiptError("file-damaged", f"{run.room_json} has not one id per object.", _EXPORT_AGAIN)
    arrays = _read_mesh(run, code, {"objects": len(names.objects), "materials": len(names.materials)})
    for name, path in ((CLOSING, run.closing_npz), (PANES, run.panes_npz)):
        added = None if names.completed else _read_added(path, arrays)
        if added is not None and len(added.triangles):
            arrays, names = _with_object(arrays, names, name, added)
    return arrays, names


def _read_mesh(run: RunFolder, code: str, sizes: Mapping[str, int] | None = None) -> dict[str, np.ndarray]:
    """The arrays of room.npz that are there; raises like `read_arrays`."""
    arrays = vars(read_arrays(run.room_npz, RoomArrays, _EXPORT_AGAIN, code, sizes))
    return {name: array for name, array in arrays.items() if array is not None}


def _with_object(
    arrays: dict[str, np.ndarray], names: RoomNames, name: str, more: AddedSurfaces
) -> tuple[dict[str, np.ndarray], RoomNames]:
    """The room with one more object; its triangles have the materials of those `beside` them, if known."""
    count, beside = len(more.triangles), more.beside
    added = {
        "vertices": more.vertices,
        "triangles": more.triangles + len(arrays["vertices"]),
        "corner_normals": more.corner_normals,
        "triangle_object": np.full(count, len(names.objects)),
        "triangle_material": np.full(count, -1) if beside is None else arrays["triangle_material"][beside],
        "triangle_polygon": np.arange(count),
        **({"triangle_exact": np.zeros(count)} if "triangle_exact" in arrays else {}),
    }
    joined = {
        key: np.concatenate([arrays[key], values.astype(arrays[key].dtype)]) for key, values in added.items()
    }
    return joined, replace(names, objects=(*names.objects, name), object_ids=(*names.ids, name))


def read_made(path: Path, kind: type[T], source: np.ndarray, sizes: Mapping[str, int]) -> T | None:
    """An array file that the engine made of what has the digest `source` (32,); None where there is none.

    A damaged one is made again, like one that was made of something else.
    """
    made: Any = optional_arrays(path, kind, sizes)
    return made if made is not None and np.array_equal(made.source, source) else None


def _read_added(path: Path, arrays: Mapping[str, np.ndarray]) -> AddedSurfaces | None:
    """closing.npz or panes.npz, None where there is none for this mesh."""
    sizes = {"triangles of the room": len(arrays["triangles"])}
    return read_made(path, AddedSurfaces, mesh_digest(arrays), sizes)


def read_scan_holes(run: RunFolder) -> ScanHoles | None:
    """What closing.npz says of a scan's holes; None where there is none for the run's mesh."""
    closing = _read_added(run.closing_npz, _read_mesh(run, "mesh-damaged"))
    return None if closing is None else closing.holes


def has_searched_panes(run: RunFolder, arrays: Mapping[str, np.ndarray], masks: np.ndarray) -> bool:
    """Whether panes.npz says that these masks (32,) show nothing that this mesh lacks.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
        masks: digest of masks and cameras.
    """
    panes = _read_added(run.panes_npz, arrays)
    found = None if panes is None or len(panes.triangles) else panes.masks
    return found is not None and np.array_equal(found, masks)


def read_atlas(run: RunFolder, triangles: int) -> tuple[AtlasImages, AtlasArrays]:
    """atlas.json, and atlas.npz.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    atlas = read_document(run.atlas_json, AtlasImages, _ATLAS_AGAIN)
    # Colour attributes need no images.
    sizes = {"triangles": triangles} | ({"images": len(atlas.images)} if atlas.mode == "uv" else {})
    return atlas, read_arrays(run.atlas_npz, AtlasArrays, _ATLAS_AGAIN, sizes=sizes)


def read_emitters(run: RunFolder, triangles: int) -> Emitters:
    """emitters.json.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    emitters = read_document(run.emitters_json, Emitters, _ESTIMATE_AGAIN)
    if any(max(fixture.triangles, default=-1) >= triangles for fixture in emitters.fixtures):
        raise FiptError(
            "file-damaged", f"{run.emitters_json} names triangles that the room lacks.", _ESTIMATE_AGAIN
        )
    return emitters


def read_geometry(run: RunFolder, arrays: Mapping[str, np.ndarray]) -> Geometry | None:
    """geometry.npz, None where there is none for this mesh: then the mesh is used as it is.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
    """
    sizes = {name: len(arrays[name]) for name in ("vertices", "triangles")}
    return read_made(run.geometry_npz, Geometry, mesh_digest(arrays), sizes)


def read_outlined(run: RunFolder, arrays: Mapping[str, np.ndarray]) -> Geometry | None:
    """geometry.npz with the vertices of outlines.npz, if these were made of it; None where the first is not.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
    """
    cleaned = read_geometry(run, arrays)
    outlines = None if cleaned is None else read_outlines(run, cleaned.vertices)
    return cleaned if cleaned is None or outlines is None else replace(cleaned, vertices=outlines.vertices)


def read_outlines(run: RunFolder, cleaned: np.ndarray) -> Outlines | None:
    """outlines.npz, None where there is none that was made of these vertices (V, 3) of geometry.npz."""
    return read_made(run.outlines_npz, Outlines, array_digest(cleaned), {"vertices": len(cleaned)})


def array_digest(*arrays: np.ndarray) -> np.ndarray:
    """(32,) uint8 digest of the content of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(digest.digest(), np.uint8)


def mesh_digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """(32,) uint8 digest of a mesh's vertices and triangles, and of which are exact."""
    exact = [arrays["triangle_exact"]] if "triangle_exact" in arrays else []
    return array_digest(arrays["vertices"].astype(np.float32), arrays["triangles"].astype(np.int32), *exact)
