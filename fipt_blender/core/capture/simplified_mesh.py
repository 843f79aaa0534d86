# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture's own mesh, simplified to a budget of triangles: a copy in the run folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..alignment.mesh_file import read_mesh
from ..depth.extraction import FusedMesh
from ..depth.ply import write_ply
from ..depth.simplification import simplified
from .rig import Note


def simplified_mesh(path: Path, triangles: int) -> tuple[FusedMesh, Note] | None:
    """The mesh of a file with at most about `triangles` triangles; None where it has no more.

    Raises:
        FiptError: one of `read_mesh`.
    """
    vertices, faces = read_mesh(path)
    if len(faces) <= triangles:
        return None
    # Formats with a vertex for each face corner would fall apart into single triangles.
    middle = vertices.mean(axis=0)
    welded, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    mesh = simplified(
        FusedMesh((welded - middle).astype(np.float32), faces.astype(np.int32)),
        triangles,
    )
    mesh = FusedMesh((mesh.vertices + middle).astype(np.float32), mesh.triangles)
    text = f"The mesh {path} was simplified from {len(faces):,} to {len(mesh.triangles):,} triangles."
    remedy = "Its material slots, colors and UVs are not kept. Set the triangles to 0 to use the mesh itself."
    return mesh, Note("mesh-simplified", text, remedy)


def write_simplified(path: Path, mesh: FusedMesh) -> None:
    """Write the copy, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    write_ply(path, mesh)
