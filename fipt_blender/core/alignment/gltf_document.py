# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON of glTF files, for the engine's reader and for the checks before Blender's importer.

Standard library only.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from ..run.documents import (
    MOST_BYTES,
    Entries,
    Fields,
    Items,
    Maybe,
    Number,
    Numbers,
    check_shape,
    parse_document,
)

PLACEMENT = {"matrix": Numbers(16), "translation": Numbers(3), "rotation": Numbers(4), "scale": Numbers(3)}
_COUNT = Number(0, 1 << 40, whole=True)
_PRIMITIVE = Fields(
    {"attributes": Fields({}, {"POSITION": _COUNT})},
    {"indices": _COUNT, "mode": Number(0, 6, whole=True), "extensions": Entries(dict)},
)
_SHAPE = Fields(
    {},
    {
        "scene": _COUNT,
        "scenes": Items(Fields({}, {"nodes": Items(_COUNT)})),
        "nodes": Items(
            Fields({}, {"children": Items(_COUNT), "mesh": _COUNT, "extensions": dict, **PLACEMENT})
        ),
        "meshes": Items(Fields({"primitives": Items(_PRIMITIVE)})),
        "accessors": Items(
            Fields(
                {"componentType": _COUNT, "count": _COUNT, "type": str},
                {"bufferView": _COUNT, "byteOffset": _COUNT, "sparse": Maybe(dict), "normalized": bool},
            )
        ),
        "bufferViews": Items(
            Fields(
                {"buffer": _COUNT, "byteLength": _COUNT},
                {"byteOffset": _COUNT, "byteStride": _COUNT, "extensions": Entries(dict)},
            )
        ),
        "buffers": Items(Fields({}, {"uri": str})),
    },
)


def read_document(path: Path) -> tuple[dict[str, Any], int]:
    """The JSON of a .gltf or .glb file, and the byte behind it, where a binary file has its buffer.

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
    content = parse_document(text.decode("utf-8"), strict=False)
    check_shape(content, _SHAPE)
    return content, start + size


def scene_roots(content: dict[str, Any]) -> list[int]:
    """The nodes of a file's scene, without their children; without scenes those that have no parent.

    Blender imports the nodes of all scenes, and how it tells them apart depends on its version.

    Raises:
        ValueError: a node is missing or has several parents, or a mesh is not in the scene.
    """
    nodes = content.get("nodes", [])
    children = [child for node in nodes for child in node.get("children", ())]
    roots = sorted(set(range(len(nodes))) - set(children))
    if content.get("scenes"):
        roots = item(content, "scenes", content.get("scene", 0)).get("nodes", [])
    for index in (*children, *roots):
        item(content, "nodes", index)
    if len({*children, *roots}) < len(children) + len(roots):
        raise ValueError("its nodes form a circle, or have several parents")
    shown: set[int] = set()
    waiting = list(roots)
    while waiting:
        index = waiting.pop()
        shown.add(index)
        waiting += nodes[index].get("children", ())
    if any("mesh" in node for index, node in enumerate(nodes) if index not in shown):
        raise ValueError("it has several scenes, or meshes in none; export one scene alone")
    return roots


def item(content: dict[str, Any], name: str, index: int) -> Any:
    """The item of a list by its index.

    Raises:
        ValueError: there is none.
    """
    items: list[Any] = content.get(name, [])
    if index >= len(items):
        raise ValueError(f"its {name} lack number {index}")
    return items[index]
