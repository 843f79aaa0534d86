"""Names of other files in mesh files: OBJ's material libraries and textures, glTF's buffers and images.

Blender's importers open them. FBX and USD files name others, too, in ways that only their readers know.
"""

from __future__ import annotations

import os
import re
import struct
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...core.run.documents import MOST_BYTES, parse_document
from ...core.run.errors import FiptError
from ...core.run.paths import is_network, is_special, leads_outside

# Not anchored to the line, as searching for plain text is many times faster. Names in comments do no harm.
_LIBRARY = re.compile(rb"mtllib[ \t]+([^\r\n]{1,4096})")
_MAPS = rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]{1,4096})"
_TEXTURE = re.compile(_MAPS, re.M | re.I)
BLOCK = 1 << 24  # bytes that are searched at a time
_GLTF = (".gltf", ".glb")
# Extensions of glTF that Blender does not read, and what their programs call them.
COMPRESSIONS = {
    "EXT_meshopt_compression": "the compression meshopt (gltfpack without -c or -cc writes none)",
    "KHR_meshopt_compression": "the compression meshopt",
    "KHR_texture_basisu": "textures as KTX2 (Basis Universal); none are needed",
    "EXT_texture_avif": "textures as AVIF; none are needed",
}
_LISTS = ("scenes", "nodes", "buffers", "images")  # of glTF's JSON that are read


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
    """Refuse a mesh file that names files which it may not name, or that Blender's importer takes wrongly."""
    try:
        check_named_files(path)
        with open(path, "rb") as file:
            if re.match(rb"ply\r[^\n]", file.read(5)):
                raise ValueError("its lines end with CR, as on old Macs; save it with other line ends")
        if path.suffix.lower() in _GLTF:
            document = _gltf(path)
            _check_extensions(path, document)
            _check_scene(document)
    except (OSError, ValueError) as error:
        raise FiptError("mesh-unreadable.check-mesh-file", path=path, error=error) from None


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
    document = _gltf(path)
    names = {each.get("uri", "data:") for each in (*document["buffers"], *document["images"])}
    return {urllib.parse.unquote(name) for name in names if not name.startswith("data:")}


def _gltf(path: Path) -> dict[str, Any]:
    """The JSON of a .gltf or .glb file, with its lists, whose items are objects.

    Raises:
        OSError: the system's.
        ValueError: what is wrong with it.
    """
    with open(path, "rb") as file:
        head, size, start = file.read(20), path.stat().st_size, 0
        if head[:4] == b"glTF":
            if len(head) < 20 or head[16:] != b"JSON":
                raise ValueError("it is cut off")
            (size,), start = struct.unpack_from("<I", head, 12), 20
        if size > MOST_BYTES:
            raise ValueError("its description is too long")
        file.seek(start)
        text = file.read(size)
    if len(text) < size:
        raise ValueError("it is cut off")
    document = parse_document(text.decode("utf-8"))
    if not isinstance(document, dict):
        raise ValueError("it is no glTF file")
    lists: dict[str, Any] = {name: document.get(name, []) for name in _LISTS}
    for name, items in lists.items():
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise ValueError(f"its {name} are damaged")
    if not all(isinstance(each.get("uri", ""), str) for each in (*lists["buffers"], *lists["images"])):
        raise ValueError("its names of files are damaged")
    return document | lists


def _check_extensions(path: Path, document: dict[str, Any]) -> None:
    """Refuse a file that is compressed in a way that Blender's importer does not read."""
    required = document.get("extensionsRequired", [])
    for name, what in COMPRESSIONS.items():
        if isinstance(required, list) and name in required:
            raise FiptError("mesh-format.compressed", path=path, name=name, what=what)


def _check_scene(document: dict[str, Any]) -> None:
    """Refuse a file whose meshes are not all in its scene.

    Blender imports the nodes of all scenes, and how it tells them apart depends on its version.

    Raises:
        ValueError: a node is missing or has several parents, or a mesh is not in the scene.
    """
    nodes, scenes = document["nodes"], document["scenes"]
    try:
        children = [list(map(range(len(nodes)).__getitem__, node.get("children", []))) for node in nodes]
        below = [child for each in children for child in each]
        waiting = sorted(set(range(len(nodes))) - set(below))
        if scenes:
            waiting = [range(len(nodes))[node] for node in scenes[document.get("scene", 0)].get("nodes", [])]
    except (IndexError, TypeError):
        raise ValueError("its scenes or nodes lack some that it numbers") from None
    if len({*below, *waiting}) < len(below) + len(waiting):
        raise ValueError("its nodes form a circle, or have several parents")
    shown: set[int] = set()
    while waiting:
        shown.add(index := waiting.pop())
        waiting += children[index]
    if any("mesh" in node for index, node in enumerate(nodes) if index not in shown):
        raise ValueError("it has several scenes, or meshes in none; export one scene alone")
