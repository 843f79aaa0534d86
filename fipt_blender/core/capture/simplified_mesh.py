# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture's own mesh, simplified to a budget of triangles: a copy in the run folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..alignment.mesh_file import read_mesh
from ..depth.extraction import FusedMesh
from ..depth.simplification import collapsed
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
    welded, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    fewer = faces.astype(np.int32)
    if len(fewer) > triangles:
        welded, fewer = collapsed(welded, fewer, triangles)
    text = f"The mesh {path} was simplified from {len(faces):,} to {len(fewer):,} triangles."
    remedy = "Its material slots, colors and UVs are not kept. Set the triangles to 0 to use the mesh itself."
    return FusedMesh(welded.astype(np.float32), fewer), Note("mesh-simplified", text, remedy)
