"""Saves the result's .blend so that it can be moved together with its textures; explains failed writes."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import bpy

from ..core.run.errors import FiptError
from ..core.run.runfolder import explained_write_errors

_PROBE_BYTES = 16_000_000


def save_blend(path: Path) -> None:
    """Save the open file under a path, compressed and atomically (Blender renames the finished file).

    Image paths become relative to it where possible.
    """
    path = Path(path).absolute()
    with explained_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        # The first save gives the file the name to which the paths then become relative.
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False, compress=True)
        bpy.ops.file.make_paths_relative()
        bpy.ops.wm.save_mainfile(compress=True)
    except RuntimeError as error:
        raise write_error(path, error, "blend-unwritable") from None


def write_error(path: Path, error: RuntimeError, code: str) -> FiptError:
    """The error for a file that Blender could not write: ``disk-full``, ``run-unwritable`` or `code`.

    Blender names the last error of the system, which is "Success" or that of another file on a full disk.
    """
    try:
        check_space(path)
        with explained_write_errors(path):
            free = shutil.disk_usage(path.parent).free
    except FiptError as reason:
        return reason
    # How large the file would be is not known.
    if free < 500_000_000:
        return FiptError("disk-full.write-error", path=path, free=free / 1e6)
    reason_text = str(error).strip().removeprefix("Error: ")
    known = "" if reason_text in ("", "Success") else f" ({reason_text})"
    return FiptError.of(
        code,
        f"{path} could not be written{known}.",
        "Choose a folder in which you may write, and check that no other program uses the file.",
    )


def check_space(path: Path) -> None:
    """Check that the folder of a file is writable and has some space left."""
    with explained_write_errors(path):
        reserve(path.parent)


def reserve(folder: Path) -> None:
    """Reserve some space in a folder for a moment."""
    with tempfile.TemporaryFile(dir=folder) as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, _PROBE_BYTES)
        else:
            file.write(bytes(_PROBE_BYTES))
            file.flush()
