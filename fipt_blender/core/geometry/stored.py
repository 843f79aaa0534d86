# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""geometry.npz: the cleaned copy of a run's scan, beside the mesh of which it was made.

A run whose mesh is no scan has no such file.
"""

from __future__ import annotations

import numpy as np

from ..run.run_files import mesh_digest, read_geometry, read_outlined, read_room_files
from ..run.runfolder import RunFolder, atomic_path, explained_write_errors
from .clean import CleanMesh, clean_mesh


def prepare_geometry(run: RunFolder, clean: bool = True) -> None:
    """Write geometry.npz where the run's mesh is a scan, and remove it where not; keep it if it fits.

    Args:
        clean: false treats every mesh as exact.

    Raises:
        FiptError: ``file-missing``, ``file-damaged``, ``disk-full`` or ``run-unwritable``.
    """
    arrays, _ = read_room_files(run, "mesh-damaged")
    if clean and read_geometry(run, arrays) is not None:
        return
    usable = clean and len(arrays["triangles"]) and np.isfinite(arrays["vertices"]).all()
    cleaned = clean_mesh(arrays["vertices"], arrays["triangles"]) if usable else None
    with explained_write_errors(run.root):
        if cleaned is None:
            run.geometry_npz.unlink(missing_ok=True)
            return
        store_geometry(run, arrays, cleaned)


def store_geometry(run: RunFolder, arrays: dict[str, np.ndarray], cleaned: CleanMesh) -> None:
    """Write geometry.npz.

    Args:
        arrays: the room's vertices and triangles, of which the copy was made.
    """
    with atomic_path(run.geometry_npz) as temporary:
        np.savez(
            temporary,
            vertices=cleaned.vertices,
            corner_normals=cleaned.corner_normals,
            plane=cleaned.plane,
            noise=np.float32(cleaned.noise),
            source=mesh_digest(arrays),
        )


def stored_geometry(
    run: RunFolder, arrays: dict[str, np.ndarray], outlined: bool = False
) -> CleanMesh | None:
    """The cleaned copy of the run's mesh, None where there is none for it.

    Args:
        arrays: content of room.npz.
        outlined: with its vertices on the outlines that masks show, where these are known.
    """
    stored = read_outlined(run, arrays) if outlined else read_geometry(run, arrays)
    if stored is None:
        return None
    noise = float(stored["noise"])
    return CleanMesh(stored["vertices"], stored["corner_normals"], stored["plane"], noise)
