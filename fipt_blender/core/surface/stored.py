# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""geometry.npz: the cleaned copy of a run's scan, beside the mesh of which it was made, and closing.npz: what
closes its small holes.

A run whose mesh is no scan has no such files. Surfaces that the artist has drawn are no scan: they do not
count for whether the mesh is one, and stay as they are.
"""

from __future__ import annotations

import numpy as np

from ..run.run_files import (
    CLOSING,
    AddedSurfaces,
    Geometry,
    RoomArrays,
    mesh_digest,
    read_closing,
    read_geometry,
    read_room,
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
    room = read_room(run)
    most_edges = 0 if room.completed else most_edges
    closing = read_closing(run)
    if (
        clean
        and (closing.most_edges if closing else 0) == most_edges
        and read_geometry(run, room) is not None
    ):
        return
    with explained_write_errors(run.root):
        if most_edges or closing:
            run.closing_npz.unlink(missing_ok=True)
            run.panes_npz.unlink(missing_ok=True)  # made for the mesh with the closing
            room = read_room(run)
        usable = clean and len(scanned(room)) and np.isfinite(room.vertices).all()
        if usable and most_edges:
            usable = _store_closing(run, room, most_edges, CLOSING in room.object_ids)
            room = read_room(run)
        cleaned = _cleaned(room) if usable else None
        if cleaned is None:
            run.geometry_npz.unlink(missing_ok=True)
            return
        store_geometry(run, room, cleaned)


def scanned(room: RoomArrays) -> np.ndarray:
    """(n,) int64 triangles of room.npz that are not exact."""
    exact = room.triangle_exact
    return np.arange(len(room.triangles)) if exact is None else np.flatnonzero(~exact)


def _cleaned(room: RoomArrays) -> CleanMesh | None:
    """The cleaned copy of the scan, with exact surfaces as they are; None for a mesh that is no scan."""
    rows = scanned(room)
    if len(rows) == len(room.triangles):
        return clean_mesh(room.vertices, room.triangles)
    used, triangles = without_unused(room.triangles[rows])
    cleaned = clean_mesh(room.vertices[used], triangles)
    if cleaned is None:
        return None
    vertices, normals = room.vertices.astype(np.float32), room.corner_normals.astype(np.float32)
    plane = np.full(len(normals), NONE, np.int32)
    vertices[used], normals[rows], plane[rows] = cleaned.vertices, cleaned.corner_normals, cleaned.plane
    return CleanMesh(vertices, normals, plane, cleaned.noise)


def _store_closing(run: RunFolder, room: RoomArrays, most_edges: int, counted: bool) -> bool:
    """Write closing.npz if the mesh is a scan, and say whether it is; `counted` holes are not closed."""
    rows = scanned(room)
    mesh, _ = make_mesh(room.vertices, room.triangles[rows])
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
        source=mesh_digest(room),
    )
    write_arrays(run.closing_npz, closing)
    return True


def store_geometry(run: RunFolder, room: RoomArrays, cleaned: CleanMesh) -> None:
    """Write geometry.npz, the copy that was made of a room."""
    vertices, normals, plane, noise = vars(cleaned).values()
    write_arrays(run.geometry_npz, Geometry(vertices, normals, plane, noise, mesh_digest(room)))
