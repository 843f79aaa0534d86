# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprints of the main job's input files: a resumed job repeats its steps if one of them has changed.

A fingerprint is a short hash of names, sizes and times of change: reading all photographs takes too long.
"""

from __future__ import annotations

import hashlib
import os
import re
import struct
import urllib.parse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..core.run.documents import MOST_BYTES, parse_document

# These may be composed of other files, whose names only a reader of the format knows.
_COMPOSED = (".usd", ".usda", ".usdc")
# Not anchored to the line, as searching for plain text is many times faster. Names in comments do no harm.
_LIBRARY = re.compile(rb"mtllib[ \t]+([^\r\n]{1,4096})")
_TEXTURE = re.compile(rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]{1,4096})", re.M | re.I)
BLOCK = 1 << 24  # bytes that are searched at a time


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
        if suffix == ".obj":
            named = _obj_files(path)
        else:
            named = _gltf_files(path) if suffix in (".gltf", ".glb") else set()
    except (OSError, ValueError):  # Blender's importer tells the user
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


def _obj_files(path: Path) -> set[Path]:
    """Material libraries of an OBJ file and their textures; each name that Blender may read from a line."""
    # Without "mtllib", Blender reads the library of the mesh's own name.
    libraries = {path.with_suffix(".mtl")}
    for line in _matches(path, _LIBRARY):
        words = line.split()
        libraries |= {path.parent / name for name in (line, *words)}
    textures = set()
    for library in libraries:
        if not library.is_file():
            continue
        for line in _matches(library, _TEXTURE):
            words = line.split(" ")
            # Options with any number of values come first; names may contain spaces.
            textures |= {library.parent / " ".join(words[i:]) for i in range(min(len(words), 32))}
    return libraries | textures


def _matches(path: Path, pattern: re.Pattern[bytes]) -> Iterator[str]:
    """The names in a text file that follow a keyword, one for each line."""
    end = b""
    with open(path, "rb") as file:
        while block := file.read(BLOCK):
            # A line may continue in the next block; the part of its name that is read here does no harm.
            for match in pattern.finditer(end + block):
                yield os.fsdecode(match[1]).strip().strip('"').replace("\\", "/")
            end = block[-8192:]


def _gltf_files(path: Path) -> set[Path]:
    """Buffers and images of a glTF file."""
    data = parse_document(_gltf_text(path), strict=False)
    files = set()
    for kind in ("buffers", "images"):
        items: Any = data.get(kind) if isinstance(data, dict) else None
        for item in items if isinstance(items, list) else ():
            name = item.get("uri") if isinstance(item, dict) else None
            if isinstance(name, str) and not name.startswith("data:"):
                files.add(path.parent / urllib.parse.unquote(name))
    return files


def _gltf_text(path: Path) -> str:
    """The JSON text of a .gltf or a .glb file."""
    with open(path, "rb") as file:
        head = file.read(20)
        size = path.stat().st_size
        if head[:4] == b"glTF" and len(head) == 20:
            (size,) = struct.unpack_from("<I", head, 12)
        else:
            file.seek(0)
        if size > MOST_BYTES:
            raise ValueError("its description is too long")
        return file.read(size).decode("utf-8")
