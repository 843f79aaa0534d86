# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of other files in mesh files: OBJ's material libraries and textures, glTF's buffers and images.

Blender's importers open them. FBX and USD files name others, too, in ways that only their readers know.
"""

from __future__ import annotations

import os
import re
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

from ...core.run.errors import FiptError
from ...core.run.paths import is_network, is_special, leads_outside
from .gltf_document import check_scenes, read_document

# Not anchored to the line, as searching for plain text is many times faster. Names in comments do no harm.
_LIBRARY = re.compile(rb"mtllib[ \t]+([^\r\n]{1,4096})")
_MAPS = rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]{1,4096})"
_TEXTURE = re.compile(_MAPS, re.M | re.I)
BLOCK = 1 << 24  # bytes that are searched at a time
_GLTF = (".gltf", ".glb")


def named_files(path: Path) -> set[str]:
    """The names in an OBJ or glTF file, relative to its folder or absolute; of other formats none.

    Raises:
        OSError: the system's.
        ValueError: the file is damaged.
    """
    if path.suffix.lower() == ".obj":
        return _obj_names(path)
    return _gltf_names(path) if path.suffix.lower() in _GLTF else set()


def check_mesh_file(path: Path) -> None:
    """Refuse a mesh file that names files which it may not name, or that Blender's importer takes wrongly.

    Raises:
        FiptError: ``mesh-unreadable``.
    """
    try:
        check_named_files(path)
        if path.suffix.lower() in _GLTF:
            check_scenes(read_document(path))
    except (OSError, ValueError) as error:
        raise FiptError(
            "mesh-unreadable",
            f"The mesh {path} can't be used: {error}.",
            "Copy or export the file again, or choose another mesh.",
        ) from None


def check_named_files(path: Path) -> None:
    """Refuse a mesh file that names files which it may not name; see `core.run.paths`.

    glTF's files are inside of the mesh's folder. Programs write OBJ's material libraries and textures with
    paths of all kinds, which may lead anywhere on this computer, but to no device.

    Raises:
        OSError: the system's.
        ValueError: names the first such name, or what is damaged.
    """
    inside = path.suffix.lower() in _GLTF
    for name in sorted(named_files(path)):
        outside = leads_outside(path.parent, name)
        if is_network(name) or (outside and inside) or is_special(path.parent / name):
            raise ValueError(f"it names the file {name[:200]!r}, outside of its folder")


def _obj_names(path: Path) -> set[str]:
    """Material libraries of an OBJ file and their textures; each name that Blender may read from a line."""
    # Without "mtllib", Blender reads the library of the mesh's own name.
    libraries = {path.with_suffix(".mtl").name}
    for line in _matches(path, _LIBRARY):
        libraries |= {line, *line.split()}
    textures = set()
    for library in libraries:
        if is_network(library) or not (path.parent / library).is_file():
            continue
        for line in _matches(path.parent / library, _TEXTURE):
            words = line.split(" ")
            # Options with any number of values come first; names may contain spaces.
            names = [" ".join(words[i:]) for i in range(min(len(words), 32))]
            folder = os.path.dirname(library)
            textures |= {name if is_network(name) else os.path.join(folder, name) for name in names}
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


def _gltf_names(path: Path) -> set[str]:
    """Buffers and images of a glTF file."""
    document = read_document(path)
    names = {each.uri or "data:" for each in (*document.buffers, *document.images)}
    return {urllib.parse.unquote(name) for name in names if not name.startswith("data:")}
