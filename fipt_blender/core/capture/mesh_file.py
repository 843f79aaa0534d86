"""Vertices and triangles of mesh files, as Blender's importers read them in a process of its own.

There a damaged file, at which an importer crashes, takes nothing along. Needs the standard library and numpy.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..run.documents import check_size
from ..run.errors import FiptError
from ..run.process_identity import running_blender

MOST_BYTES = 4_000_000_000  # of a mesh file
PATIENCE = 1800.0  # seconds that an importer may take
_START = Path(__file__).resolve().parents[2] / "bridge" / "start.py"
_READER = "fipt_blender.blend.capture.mesh_reading"


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int64 of a mesh file, in the file's own coordinates.

    Args:
        path: file of a format that Blender imports.
    """
    if not path.is_file():
        raise FiptError("mesh-missing.read-mesh", path=path)
    try:
        check_size(path, MOST_BYTES)
    except ValueError as error:
        raise _unreadable(path, str(error)) from None
    return read_in_blender(path.absolute(), path.stat().st_mtime_ns)


@lru_cache(maxsize=1)  # an import asks for one mesh several times
def read_in_blender(path: Path, changed: int) -> tuple[np.ndarray, np.ndarray]:
    """As `read_mesh`, of an absolute path and the time of the file's last change in nanoseconds."""
    blender = running_blender()
    with tempfile.TemporaryDirectory(prefix="fipt_mesh_") as folder:
        arrays, problem = Path(folder) / "mesh.npz", Path(folder) / "mesh.json"
        argv = ["", _READER, str(path), str(arrays)]
        code = f"import runpy, sys; sys.argv = {argv}; runpy.run_path({str(_START)!r}, run_name='__main__')"
        is_python = Path(blender).stem.lower().startswith("python")
        options = ["-I", "-c"] if is_python else ["--background", "--factory-startup", "--python-expr"]
        try:
            result = subprocess.run(
                [blender, *options, code],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE,
                check=False,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # else Windows opens a console
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _unreadable(path, f"Blender can't read it: {error}") from None
        if problem.is_file():
            raise FiptError.of(*json.loads(problem.read_text("utf-8")))
        if not arrays.is_file():
            last = result.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
            raise _unreadable(path, f"Blender's importer ended with status {result.returncode} {last}")
        with np.load(arrays) as found:
            return found["vertices"], found["triangles"]


def _unreadable(path: Path, reason: str) -> FiptError:
    return FiptError("mesh-unreadable.unreadable-2", path=path, reason=reason)
