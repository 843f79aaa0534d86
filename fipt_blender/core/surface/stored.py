# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""geometry.npz: the cleaned copy of a run's scan, beside the mesh of which it was made, and closing.npz: what
closes its small holes.

A run whose mesh is no scan has no such files. Surfaces that the artist has drawn are no scan: they do not
count for whether the mesh is one, and stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..run.run_files import (
    CLOSING,
    AddedSurfaces,
    Geometry,
    mesh_digest,
    read_closing,
    read_geometry,
    read_room_files,
)
from ..run.runfolder import RunFolder, explained_write_errors
from ..run.store import write_arrays
from .adjacency import NONE, face_vectors, make_mesh, without_unused
from .clean import CleanMesh, clean_mesh, noise_level
from .closing import close_small_holes


def prepare_geometry(run: RunFolder, clean: bool = True, most_edges: int = 0) -> None:
    """Write geometry.npz and closing.npz where the run's mesh is a scan, and remove them where not.

    Files that fit are kept.

    Args:
        clean: false treats every mesh as exact.
        most_edges: of holes that are closed, none with 0, nor in a room that the artist has completed.

    Raises:
        FiptError: ``file-missing``, ``file-damaged``, ``disk-full`` or ``run-unwritable``.
    """
    arrays, names = read_room_files(run)
    most_edges = 0 if names.completed else most_edges
    closing = read_closing(run)
    if (
        clean
        and (closing.most_edges if closing else 0) == most_edges
        and read_geometry(run, arrays) is not None
    ):
        return
    with explained_write_errors(run.root):
        if most_edges or closing:
            run.closing_npz.unlink(missing_ok=True)
            run.panes_npz.unlink(missing_ok=True)  # made for the mesh with the closing
            arrays, names = read_room_files(run)
        usable = clean and len(scanned(arrays)) and np.isfinite(arrays["vertices"]).all()
        if usable and most_edges:
            closed_before = CLOSING in names.ids
            usable = _store_closing(run, arrays, most_edges, closed_before)
            arrays, _ = read_room_files(run)
        cleaned = _cleaned(arrays) if usable else None
        if cleaned is None:
            run.geometry_npz.unlink(missing_ok=True)
            return
        store_geometry(run, arrays, cleaned)


def scanned(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n,) int64 triangles of room.npz that are not exact."""
    exact = arrays.get("triangle_exact")
    return np.arange(len(arrays["triangles"])) if exact is None else np.flatnonzero(~exact)


def _cleaned(arrays: Mapping[str, np.ndarray]) -> CleanMesh | None:
    """The cleaned copy of the scan, with exact surfaces as they are; None for a mesh that is no scan."""
    rows = scanned(arrays)
    if len(rows) == len(arrays["triangles"]):
        return clean_mesh(arrays["vertices"], arrays["triangles"])
    used, triangles = without_unused(arrays["triangles"][rows])
    cleaned = clean_mesh(arrays["vertices"][used], triangles)
    if cleaned is None:
        return None
    vertices, normals = (arrays[name].astype(np.float32) for name in ("vertices", "corner_normals"))
    plane = np.full(len(normals), NONE, np.int32)
    vertices[used], normals[rows], plane[rows] = cleaned.vertices, cleaned.corner_normals, cleaned.plane
    return CleanMesh(vertices, normals, plane, cleaned.noise)


def _store_closing(run: RunFolder, arrays: dict[str, np.ndarray], most_edges: int, counted: bool) -> bool:
    """Write closing.npz if the mesh is a scan, and say whether it is.

    Args:
        arrays: the room's vertices and triangles.
        counted: holes are counted, not closed.
    """
    rows = scanned(arrays)
    mesh, _ = make_mesh(arrays["vertices"], arrays["triangles"][rows])
    normals, areas = face_vectors(mesh.vertices, mesh.triangles)
    if noise_level(mesh, normals, areas)[0] <= 0.0:
        return False
    found = close_small_holes(mesh, normals, 0 if counted else most_edges)
    facing = face_vectors(found.vertices, found.triangles)[0]
    closing = AddedSurfaces(
        vertices=found.vertices.astype(np.float32),
        triangles=found.triangles,
        corner_normals=np.repeat(facing[:, None], 3, axis=1).astype(np.float32),
        beside=rows[found.beside],
        most_edges=most_edges,
        count=np.array([found.closed, found.left], np.int32),
        area=np.array([found.closed_area, found.open_area], np.float32),
        source=mesh_digest(arrays),
    )
    write_arrays(run.closing_npz, closing)
    return True


def store_geometry(run: RunFolder, arrays: dict[str, np.ndarray], cleaned: CleanMesh) -> None:
    """Write geometry.npz.

    Args:
        arrays: the room's vertices and triangles, of which the copy was made.
    """
    vertices, normals, plane, noise = vars(cleaned).values()
    write_arrays(run.geometry_npz, Geometry(vertices, normals, plane, noise, mesh_digest(arrays)))
