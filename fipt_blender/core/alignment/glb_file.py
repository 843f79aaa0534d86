# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and triangles of binary glTF files in the file's own coordinates (Y up): all nodes of its scene.

Every fault of a file becomes a ValueError, and nothing is allocated that the file does not hold.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from ..run.documents import Fields, Items, Maybe, Number, Numbers, check_shape, parse_document

_COUNT = Number(0, 1 << 40, whole=True)
_TRIANGLES = 4  # the primitive mode of glTF
_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPE = Fields(
    {},
    {
        "scene": _COUNT,
        "scenes": Items(Fields({}, {"nodes": Items(_COUNT)})),
        "nodes": Items(
            Fields(
                {},
                {
                    "children": Items(_COUNT),
                    "mesh": _COUNT,
                    "matrix": Numbers(16),
                    "translation": Numbers(3),
                    "rotation": Numbers(4),
                    "scale": Numbers(3),
                },
            )
        ),
        "meshes": Items(
            Fields(
                {
                    "primitives": Items(
                        Fields(
                            {"attributes": Fields({}, {"POSITION": _COUNT})},
                            {"indices": _COUNT, "mode": _COUNT, "extensions": dict},
                        )
                    )
                }
            )
        ),
        "accessors": Items(
            Fields(
                {"componentType": _COUNT, "count": _COUNT, "type": str},
                {"bufferView": _COUNT, "byteOffset": _COUNT, "sparse": Maybe(dict)},
            )
        ),
        "bufferViews": Items(
            Fields({"buffer": _COUNT, "byteLength": _COUNT}, {"byteOffset": _COUNT, "byteStride": _COUNT})
        ),
    },
)


def read_glb(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int64 of a .glb file.

    Raises:
        ValueError: the file is damaged or compressed, or has external buffers.
    """
    content, binary = _chunks(data)
    check_shape(content, _SHAPE)
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    count = 0
    for mesh, matrix in _placed_meshes(content):
        for primitive in _item(content, "meshes", mesh)["primitives"]:
            found = _primitive(content, binary, primitive)
            if found is not None:
                vertices.append(found[0] @ matrix[:3, :3].T + matrix[:3, 3])
                triangles.append(found[1] + count)
                count += len(found[0])
    if not vertices:
        raise ValueError("it holds no triangles")
    return np.concatenate(vertices), np.concatenate(triangles)


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise ValueError("it is no binary glTF")
    length, kind = struct.unpack_from("<II", data, 12)
    end = 20 + length
    if kind != 0x4E4F534A or end > len(data):
        raise ValueError("it is cut off")
    content = parse_document(data[20:end].decode("utf-8"), strict=False)
    if not isinstance(content, dict):
        raise ValueError("its JSON is no object")
    if end + 8 > len(data):
        return content, b""
    length, kind = struct.unpack_from("<II", data, end)
    if kind != 0x004E4942 or end + 8 + length > len(data):
        raise ValueError("it is cut off")
    return content, data[end + 8 : end + 8 + length]


def _placed_meshes(content: dict[str, Any]) -> list[tuple[int, np.ndarray]]:
    """Index of each mesh that the scene shows, with its matrix (4, 4)."""
    nodes = content.get("nodes", [])
    scenes = content.get("scenes", [])
    chosen = content.get("scene", 0)
    if scenes:
        roots = _item(content, "scenes", chosen).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    waiting = [(root, np.eye(4)) for root in roots]
    found: list[tuple[int, np.ndarray]] = []
    visited = 0
    while waiting:
        index, parent = waiting.pop()
        visited += 1
        if visited > min(len(nodes), 100_000):  # a node has one parent, so that none comes twice
            raise ValueError("its nodes form a circle or are too many")
        node = _item(content, "nodes", index)
        matrix = parent @ _matrix(node)
        if "mesh" in node:
            found.append((node["mesh"], matrix))
        waiting += [(child, matrix) for child in node.get("children", [])]
    return found


def _matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    size = x * x + y * y + z * z + w * w
    double = 2.0 / size if size > 0.0 else 0.0
    rotation = np.eye(3) - double * np.array(
        [
            [y * y + z * z, w * z - x * y, -x * z - w * y],
            [-x * y - w * z, x * x + z * z, w * x - y * z],
            [w * y - x * z, -y * z - w * x, x * x + y * y],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _primitive(
    content: dict[str, Any], binary: bytes, primitive: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and triangles; None for points and lines."""
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES or "POSITION" not in primitive["attributes"]:
        return None
    if primitive.get("extensions"):
        names = ", ".join(str(name) for name in primitive["extensions"])
        if "compression" in names:
            raise ValueError(f"it is compressed ({names})")
    positions = _accessor(content, binary, primitive["attributes"]["POSITION"], 3).astype(np.float64)
    if "indices" in primitive:
        corners = _accessor(content, binary, primitive["indices"], 1).astype(np.int64).reshape(-1)
    else:
        corners = np.arange(len(positions), dtype=np.int64)
    if len(corners) and corners.max() >= len(positions):
        raise ValueError("a face has a vertex that is not there")
    return positions, corners[: len(corners) // 3 * 3].reshape(-1, 3)


def _accessor(content: dict[str, Any], binary: bytes, index: int, width: int) -> np.ndarray:
    """The (count, width) numbers of an accessor."""
    accessor = _item(content, "accessors", index)
    if accessor["type"] != ("VEC3" if width == 3 else "SCALAR") or accessor["componentType"] not in _TYPES:
        raise ValueError("an accessor has another type than its use needs")
    if "bufferView" not in accessor or accessor.get("sparse"):
        raise ValueError("it has sparse accessors")
    kind = np.dtype(_TYPES[accessor["componentType"]])
    if (kind.kind == "f") != (width == 3):
        raise ValueError("an accessor has another type than its use needs")
    view = _item(content, "bufferViews", accessor["bufferView"])
    stride = view.get("byteStride", width * kind.itemsize)
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    count = accessor["count"]
    end = start + stride * (count - 1) + width * kind.itemsize
    if view["buffer"] != 0 or stride < width * kind.itemsize or (count and end > len(binary)):
        raise ValueError("a buffer is missing or cut off")
    if not count:
        return np.zeros((0, width), kind)
    return np.ndarray((count, width), kind, binary, start, (stride, kind.itemsize))


def _item(content: dict[str, Any], name: str, index: int) -> dict[str, Any]:
    items: list[dict[str, Any]] = content.get(name, [])
    if index >= len(items):
        raise ValueError(f"its {name} lack number {index}")
    return items[index]
