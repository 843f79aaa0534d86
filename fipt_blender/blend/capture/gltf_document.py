# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON of glTF files, for the checks before Blender's importer."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ...core.run.documents import MOST_BYTES, parse_document
from ...core.run.kinds import Number, as_kind

_Count = Annotated[int, Number(0, 1 << 40)]

# Fields are named as in the files.


@dataclass(frozen=True)
class Node:
    """Where its mesh and its children are."""

    children: tuple[_Count, ...] = ()
    mesh: _Count | None = None


@dataclass(frozen=True)
class Scene:
    """Its nodes without parents."""

    nodes: tuple[_Count, ...] = ()


@dataclass(frozen=True)
class Named:
    """The file of a buffer or an image; None for one in the binary file."""

    uri: str | None = None


@dataclass(frozen=True)
class Document:
    """What is read of a glTF file."""

    scene: _Count = 0
    scenes: tuple[Scene, ...] = ()
    nodes: tuple[Node, ...] = ()
    buffers: tuple[Named, ...] = ()
    images: tuple[Named, ...] = ()


def read_document(path: Path) -> Document:
    """The JSON of a .gltf or .glb file.

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
    return as_kind(parse_document(text.decode("utf-8")), Document)


def check_scenes(document: Document) -> None:
    """Refuse a file whose meshes are not all in its scene.

    Blender imports the nodes of all scenes, and how it tells them apart depends on its version.

    Raises:
        ValueError: a node is missing or has several parents, or a mesh is not in the scene.
    """
    nodes = document.nodes
    children = [child for node in nodes for child in node.children]
    roots = sorted(set(range(len(nodes))) - set(children))
    if document.scenes:
        roots = list(item(document, "scenes", document.scene).nodes)
    for index in (*children, *roots):
        item(document, "nodes", index)
    if len({*children, *roots}) < len(children) + len(roots):
        raise ValueError("its nodes form a circle, or have several parents")
    shown: set[int] = set()
    waiting = list(roots)
    while waiting:
        index = waiting.pop()
        shown.add(index)
        waiting += nodes[index].children
    if any(node.mesh is not None for index, node in enumerate(nodes) if index not in shown):
        raise ValueError("it has several scenes, or meshes in none; export one scene alone")


def item(document: Document, name: str, index: int) -> Any:
    """The item of a list by its index.

    Raises:
        ValueError: there is none.
    """
    items: Sequence[Any] = getattr(document, name)
    if index >= len(items):
        raise ValueError(f"its {name} lack number {index}")
    return items[index]
