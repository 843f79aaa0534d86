# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprints of the main job's input files: a resumed job repeats its steps if one of them has changed.

A fingerprint is a short hash of names, sizes and times of change: reading all photographs takes too long.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

from ..blend.capture.mesh_names import named_files

# These may be composed of other files, whose names only a reader of the format knows.
_COMPOSED = (".usd", ".usda", ".usdc")


def folder_fingerprint(path: Path, exclude: Path | None = None) -> str:
    """The fingerprint of a file or of all files below a folder.

    Args:
        path: file or folder; for a file, all files below its folder count (a camera file names images there).
        exclude: folder that is left out, because the job itself writes there.
    """
    folder = os.path.realpath(path if path.is_dir() else path.parent)
    excluded = None if exclude is None else os.path.realpath(exclude)
    states = []
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if os.path.join(parent, name) != excluded)
        for name in names:
            state = _state(Path(parent, name))
            if state is not None:  # a dangling link is left out: its target may come and go
                states.append(f"{os.path.relpath(os.path.join(parent, name), folder)}|{state}")
    return _hashed(path, states)


def mesh_fingerprint(path: Path, exclude: Path | None = None) -> str:
    """The fingerprint of a mesh file and of the files that it names.

    These are OBJ's material libraries and their textures, and glTF's buffers and images. USD files may be
    composed of any others: there all files below the folder count.

    Args:
        path: of the mesh file.
        exclude: as in :func:`folder_fingerprint`.
    """
    suffix = path.suffix.lower()
    if suffix in _COMPOSED:
        return folder_fingerprint(path, exclude)
    try:
        named = {path.parent / name for name in named_files(path)}
    except (OSError, ValueError):  # the import reports it to the user
        named = set()
    return _hashed(path, (f"{file}|{_state(file)}" for file in {path, *named}))


def _hashed(path: Path, states: Iterable[str]) -> str:
    return hashlib.sha256("\n".join([str(path), *sorted(states)]).encode(errors="replace")).hexdigest()[:24]


def _state(file: Path) -> str | None:
    """Size and time of change of a file; None where there is none."""
    try:
        status = file.stat()
    except (OSError, ValueError):  # also names that no file can have
        return None
    return f"{status.st_size}|{status.st_mtime_ns}"
