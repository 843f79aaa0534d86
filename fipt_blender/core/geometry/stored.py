# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""geometry.npz: the cleaned copy of a run's scan, beside the mesh of which it was made.

A run whose mesh is no scan has no such file.
"""

from __future__ import annotations

import hashlib

import numpy as np

from ..run.arrays import read_arrays
from ..run.errors import FiptError
from ..run.run_files import read_room_files
from ..run.runfolder import RunFolder, atomic_path, explained_write_errors
from ..run.shapes import GEOMETRY_ARRAYS
from .clean import CleanMesh, clean_mesh

_EXPORT_AGAIN = "Export the room's mesh again (start the estimation again)."
_PAIRS = (("vertices", "vertices"), ("plane", "triangles"))  # of equal length in geometry.npz and room.npz


def prepare_geometry(run: RunFolder, clean: bool = True) -> None:
    """Write geometry.npz where the run's mesh is a scan, and remove it where not; keep it if it fits.

    Args:
        clean: false treats every mesh as exact.

    Raises:
        FiptError: ``file-missing``, ``file-damaged``, ``disk-full`` or ``run-unwritable``.
    """
    arrays, _ = read_room_files(run, "mesh-damaged")
    if clean and _fitting(run, arrays) is not None:
        return
    usable = clean and len(arrays["triangles"]) and np.isfinite(arrays["vertices"]).all()
    cleaned = clean_mesh(arrays["vertices"], arrays["triangles"]) if usable else None
    with explained_write_errors(run.root):
        if cleaned is None:
            run.geometry_npz.unlink(missing_ok=True)
            return
        with atomic_path(run.geometry_npz) as temporary:
            np.savez(
                temporary,
                vertices=cleaned.vertices,
                corner_normals=cleaned.corner_normals,
                plane=cleaned.plane,
                noise=np.float32(cleaned.noise),
                source=_digest(arrays),
            )


def stored_geometry(run: RunFolder, arrays: dict[str, np.ndarray]) -> CleanMesh | None:
    """The cleaned copy of the run's mesh, None where there is none for it.

    Args:
        arrays: content of room.npz.

    Raises:
        FiptError: ``file-damaged``.
    """
    stored = _fitting(run, arrays)
    if stored is None:
        return None
    noise = float(stored["noise"])
    return CleanMesh(stored["vertices"], stored["corner_normals"], stored["plane"], noise)


def _fitting(run: RunFolder, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """Content of geometry.npz if it was made of this mesh, else None."""
    if not run.geometry_npz.exists():
        return None
    try:
        stored = read_arrays(run.geometry_npz, GEOMETRY_ARRAYS, remedy=_EXPORT_AGAIN)
    except FiptError:
        return None
    sizes = all(len(stored[one]) == len(arrays[other]) for one, other in _PAIRS)
    finite = np.isfinite(stored["vertices"]).all() and np.isfinite(stored["corner_normals"]).all()
    if not (sizes and finite and np.isfinite(stored["noise"])):
        return None
    return stored if np.array_equal(stored["source"], _digest(arrays)) else None


def _digest(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(32,) uint8 that tells meshes apart."""
    digest = hashlib.sha256()
    for name in ("vertices", "triangles"):
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return np.frombuffer(digest.digest(), np.uint8)
