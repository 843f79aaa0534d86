# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of the run folder that both processes read, with the checks that need more than one of their values.

Needs numpy alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .arrays import check_layouts, read_arrays
from .contents import CapturedViews, RoomNames
from .documents import read_document
from .errors import FiptError
from .result_contents import AtlasImages, Emitters
from .runfolder import RunFolder
from .shapes import (
    ATLAS_ARRAYS,
    CLOSING_ARRAYS,
    EXACT_ARRAYS,
    GEOMETRY_ARRAYS,
    LEFT_ALONE_ARRAYS,
    OUTLINES_ARRAYS,
    PANES_ARRAYS,
    RESOLUTION_ARRAYS,
    ROOM_ARRAYS,
    Layout,
)

# Names and ids of the objects of what the engine has added to a scan: triangles that close small holes, and
# panes in larger ones with the surfaces that photographs show.
CLOSING = "FIPT Closed Holes"
PANES = "FIPT Panes"
_EXPORT_AGAIN = "Export the room's mesh again (start the estimation again)."
_ATLAS_AGAIN = "Start the run again without --resume, or apply the results again."
_ESTIMATE_AGAIN = "Run the estimation again."


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
    arrays = _read_mesh(run, code)
    ranges = (
        ("triangles", 0, len(arrays["vertices"]), "vertices"),
        ("triangle_object", 0, len(names.objects), "objects"),
        ("triangle_material", -1, len(names.materials), "materials"),
        ("triangle_polygon", 0, np.iinfo(np.int32).max, "polygons"),
    )
    for name, low, end, what in ranges:
        if not _within(arrays[name], low, end):
            text = f"The room's mesh in {run.room_npz} refers to missing {what}."
            raise FiptError(code, text, _EXPORT_AGAIN)
    if names.completed:
        return arrays, names
    for name, path, layout in (
        (CLOSING, run.closing_npz, CLOSING_ARRAYS),
        (PANES, run.panes_npz, PANES_ARRAYS),
    ):
        added = _read_added(path, layout, arrays)
        if added is not None and len(added["triangles"]):
            arrays, names = _with_object(arrays, names, name, added)
    return arrays, names


def _read_mesh(run: RunFolder, code: str) -> dict[str, np.ndarray]:
    """The arrays of room.npz.

    Raises:
        FiptError: ``file-missing`` or `code`.
    """
    arrays = read_arrays(run.room_npz, ROOM_ARRAYS, code, _EXPORT_AGAIN)
    if "triangle_exact" in arrays:
        try:
            check_layouts(arrays, EXACT_ARRAYS)
        except ValueError as error:
            raise FiptError(code, f"{run.room_npz} can't be read ({error}).", _EXPORT_AGAIN) from None
    return arrays


def _with_object(
    arrays: dict[str, np.ndarray], names: RoomNames, name: str, more: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], RoomNames]:
    """The room with one more object; its triangles have the materials of those `beside` them, if known."""
    count = len(more["triangles"])
    beside = more.get("beside")
    added = {
        "vertices": more["vertices"],
        "triangles": more["triangles"] + len(arrays["vertices"]),
        "corner_normals": more["corner_normals"],
        "triangle_object": np.full(count, len(names.objects)),
        "triangle_material": np.full(count, -1) if beside is None else arrays["triangle_material"][beside],
        "triangle_polygon": np.arange(count),
        **({"triangle_exact": np.zeros(count)} if "triangle_exact" in arrays else {}),
    }
    joined = {
        key: np.concatenate([arrays[key], values.astype(arrays[key].dtype)]) for key, values in added.items()
    }
    return joined, replace(names, objects=(*names.objects, name), object_ids=(*names.ids, name))


def _read_added(
    path: Path, layout: Mapping[str, Layout], arrays: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray] | None:
    """closing.npz or panes.npz, None where there is none for this mesh."""
    if not path.exists():
        return None
    try:
        added = read_arrays(path, layout)
    except FiptError:
        return None
    fits = _within(added["triangles"], 0, len(added["vertices"]))
    fits &= _within(added.get("beside", added["triangles"][:0]), 0, len(arrays["triangles"]))
    fits &= all(bool(np.isfinite(added[name]).all()) for name in ("vertices", "corner_normals"))
    return added if fits and np.array_equal(added["source"], mesh_digest(arrays)) else None


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


def read_scan_holes(run: RunFolder) -> ScanHoles | None:
    """What closing.npz says of a scan's holes; None where there is none for the run's mesh."""
    arrays = _read_mesh(run, "mesh-damaged")
    closing = _read_added(run.closing_npz, CLOSING_ARRAYS, arrays)
    if closing is None:
        return None
    closed, left = map(int, closing["count"])
    closed_area, open_area = map(float, closing["area"])
    return ScanHoles(closed, left, closed_area, open_area, int(closing["most_edges"]))


def has_searched_panes(run: RunFolder, arrays: Mapping[str, np.ndarray], masks: np.ndarray) -> bool:
    """Whether panes.npz says that these masks (32,) show nothing that this mesh lacks.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
        masks: digest of masks and cameras.
    """
    try:
        panes = read_arrays(run.panes_npz, PANES_ARRAYS)
    except FiptError:
        return False
    fits = np.array_equal(panes["source"], mesh_digest(arrays)) and not len(panes["triangles"])
    return fits and np.array_equal(panes.get("masks", []), masks)


def read_atlas(run: RunFolder, triangles: int) -> tuple[AtlasImages, dict[str, np.ndarray]]:
    """atlas.json, and the arrays of atlas.npz.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    atlas = read_document(run.atlas_json, AtlasImages, _ATLAS_AGAIN)
    arrays = read_arrays(run.atlas_npz, ATLAS_ARRAYS, remedy=_ATLAS_AGAIN)
    image = arrays["triangle_image"]
    is_uv = atlas.mode == "uv"  # colour attributes need no images
    if len(image) != triangles or (is_uv and not _within(image, -1, len(atlas.images))):
        raise FiptError(
            "file-damaged", f"{run.atlas_npz} does not fit the room and {run.atlas_json}.", _ATLAS_AGAIN
        )
    return atlas, arrays


def read_resolution(run: RunFolder, triangles: int) -> np.ndarray | None:
    """(T,) float32 texels a metre that the photographs resolve on each triangle, NaN on unseen ones.

    None where they have no more pixels than light was solved at, and where the file does not fit the room.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-damaged``.
    """
    if not run.resolution_npz.exists():
        return None
    density = read_arrays(run.resolution_npz, RESOLUTION_ARRAYS, remedy=_ESTIMATE_AGAIN)["density"]
    return density if len(density) == triangles else None


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


def read_left_alone(run: RunFolder, triangles: int) -> np.ndarray:
    """(T,) bool, triangles that were not estimated on the artist's request; none where the run has no file.

    Args:
        run: the run folder.
        triangles: how many the room has.

    Raises:
        FiptError: ``file-damaged``.
    """
    if not run.left_alone_npz.is_file():
        return np.zeros(triangles, bool)
    left = read_arrays(run.left_alone_npz, LEFT_ALONE_ARRAYS, remedy=_ESTIMATE_AGAIN)["left_alone"]
    if len(left) != triangles:
        raise FiptError("file-damaged", f"{run.left_alone_npz} does not fit the room.", _ESTIMATE_AGAIN)
    return left


def read_geometry(run: RunFolder, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """geometry.npz, None where there is none for this mesh: then the mesh is used as it is.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
    """
    if not run.geometry_npz.exists():
        return None
    try:
        stored = read_arrays(run.geometry_npz, GEOMETRY_ARRAYS)
    except FiptError:
        return None
    pairs = (("vertices", "vertices"), ("plane", "triangles"))
    fits = all(len(stored[one]) == len(arrays[other]) for one, other in pairs)
    fits &= all(bool(np.isfinite(stored[name]).all()) for name in ("vertices", "corner_normals", "noise"))
    return stored if fits and np.array_equal(stored["source"], mesh_digest(arrays)) else None


def read_outlined(run: RunFolder, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """geometry.npz with the vertices of outlines.npz, if these were made of it; None where the first is not.

    Args:
        run: the run folder.
        arrays: the room's vertices and triangles.
    """
    cleaned = read_geometry(run, arrays)
    outlines = None if cleaned is None else read_outlines(run, cleaned["vertices"])
    return cleaned if cleaned is None or outlines is None else {**cleaned, "vertices": outlines["vertices"]}


def read_outlines(run: RunFolder, cleaned: np.ndarray) -> dict[str, np.ndarray] | None:
    """outlines.npz, None where there is none that was made of these vertices (V, 3) of geometry.npz."""
    if not run.outlines_npz.exists():
        return None
    try:
        stored = read_arrays(run.outlines_npz, OUTLINES_ARRAYS)
    except FiptError:
        return None
    fits = stored["vertices"].shape == cleaned.shape and bool(np.isfinite(stored["vertices"]).all())
    return stored if fits and np.array_equal(stored["cleaned"], array_digest(cleaned)) else None


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


def _within(values: np.ndarray, low: int, end: int) -> bool:
    """Whether all indices lie in low <= index < end."""
    return not values.size or bool(values.min() >= low and values.max() < end)
