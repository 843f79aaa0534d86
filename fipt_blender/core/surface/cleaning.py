"""The cleaned copy of a scan, and what closes its small holes.

Surfaces that the artist has drawn are no scan: they do not count for whether the mesh is one, and stay as
they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.run_files import CLOSING, AddedSurfaces, Geometry, RoomArrays, RoomMesh, with_added
from ..run.stage_settings import ScanSettings
from .adjacency import NONE, face_vectors, make_mesh, without_unused
from .clean import clean_mesh, noise_level
from .closing import close_small_holes


@dataclass(frozen=True)
class Holes:
    """The small holes of a scan, which were closed, and those that stay open, with their areas in m2."""

    closed: int
    left: int
    closed_area: float
    open_area: float

    @property
    def text(self) -> str:
        """A sentence on them."""
        return (
            f"The scan has {self.closed:,} small holes, which were closed ({self.closed_area:.2g} m2), and"
            f" {self.left:,} large ones, which stay open ({self.open_area:.2g} m2)."
        )


@dataclass(frozen=True, eq=False)
class CleanedScan:
    """What is made of a mesh alone; None without.

    Attributes:
        closing: of its small holes.
        holes: these, and those that are left.
        cleaned: the geometry of the mesh with the closing; None where it is no scan.
    """

    closing: AddedSurfaces | None = None
    holes: Holes | None = None
    cleaned: Geometry | None = None


def clean_room(mesh: RoomMesh, *, settings: ScanSettings) -> CleanedScan:
    """Clean a scan, after its small holes were closed; nothing for an exact mesh.

    In a room that the artist has completed none are closed.
    """
    if not (settings.clean_scan and len(scanned(mesh)) and np.isfinite(mesh.vertices).all()):
        return CleanedScan()
    closing = holes = None
    if settings.close_holes_edges and not mesh.completed:
        found = _closed(mesh, settings.close_holes_edges)
        if found is None:
            return CleanedScan()
        closing, holes = found
        mesh = with_added(mesh, closing, None)
    cleaned = _cleaned(mesh)
    return CleanedScan() if cleaned is None else CleanedScan(closing, holes, cleaned)


def scanned(room: RoomArrays) -> np.ndarray:
    """(n,) int64 triangles of room.npz that are not exact."""
    exact = room.triangle_exact
    return np.arange(len(room.triangles)) if exact is None else np.flatnonzero(~exact)


def _cleaned(room: RoomArrays) -> Geometry | None:
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
    return Geometry(vertices, normals, plane, cleaned.noise)


def _closed(room: RoomMesh, most_edges: int) -> tuple[AddedSurfaces, Holes] | None:
    """What closes the holes of a scan; nothing where it has been closed before. None for another mesh."""
    rows = scanned(room)
    mesh, _ = make_mesh(room.vertices, room.triangles[rows])
    normals, areas = face_vectors(mesh.vertices, mesh.triangles)
    if noise_level(mesh, normals, areas)[0] <= 0.0:
        return None
    found = close_small_holes(mesh, normals, 0 if CLOSING in room.object_ids else most_edges)
    facing = face_vectors(found.vertices, found.triangles)[0]
    closing = AddedSurfaces(
        vertices=found.vertices.astype(np.float32),
        triangles=found.triangles,
        corner_normals=np.repeat(facing[:, None], 3, axis=1).astype(np.float32),
        beside=rows[found.beside],
    )
    return closing, Holes(found.closed, found.left, float(found.closed_area), float(found.open_area))
