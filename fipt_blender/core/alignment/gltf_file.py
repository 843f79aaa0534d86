# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices and triangles of glTF files in the file's own coordinates (Y up).

trimesh reads the accessors and places the nodes. What it would leave out or get wrong without a word (fans,
nodes with cameras or lines, normalized integers, sparse and compressed accessors, files without scenes) is
rewritten before, or refused. Nothing is allocated that the file does not hold.
"""

from __future__ import annotations

import base64
import io
import json
import urllib.parse
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ..run.documents import read_limited
from ..run.paths import leads_outside
from .gltf_document import PLACEMENT, item, read_document, scene_roots

MOST_BYTES = 4_000_000_000  # of a mesh file, and of its meshes in memory
MOST_NODES = 100_000  # of the nodes and primitives of a file, so that no file takes minutes
_ROW = 24  # bytes of a vertex or of a triangle in memory
_TRIANGLES, _FAN = 4, 6  # primitive modes; those below are points and lines, that between them is a strip
# Component type -> bytes, and the integer that stands for 1 where they are normalized.
_TYPES = {5120: (1, 127), 5121: (1, 255), 5122: (2, 32767), 5123: (2, 65535), 5125: (4, 0), 5126: (4, 0)}
_POSITIONS, _INDICES = (5120, 5121, 5122, 5123, 5126), (5121, 5123, 5125)
# Extensions that move or replace meshes; others change materials, lights and cameras.
_UNREADABLE = ("compression", "gpu_instancing")


def read_gltf(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (T, 3) int64 of a .gltf or .glb file.

    Raises:
        OSError: the system's.
        ValueError: the file is damaged, compressed, or names files outside of its folder.
    """
    content, end = read_document(path)
    binary = _binary(read_limited(path, MOST_BYTES), end)
    plain, primitives = _plain(content)
    buffers = {
        entry["uri"]: _buffer(content, int(entry["uri"]), binary, path.parent) for entry in plain["buffers"]
    }
    scene = load_scene(json.dumps(plain).encode(), "gltf", resolver=buffers, skip_materials=True)
    for name, mesh in scene.geometry.items():
        _correct(mesh, primitives[int(name)], plain["accessors"][2 * int(name)])
    found = scene.to_mesh()
    return np.array(found.vertices, np.float64), np.array(found.faces, np.int64)


def load_scene(data: bytes, kind: str, **options: Any) -> trimesh.Scene:
    """A file as trimesh reads it, with all vertices as they are.

    Raises:
        ValueError: trimesh or numpy fails.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # numpy's at text that is no number
            return trimesh.load_scene(io.BytesIO(data), kind, process=False, **options)
    except Exception as error:  # of any kind, at damaged files
        raise ValueError(str(error) or type(error).__name__) from None


def _correct(mesh: trimesh.Trimesh, primitive: dict[str, Any], positions: dict[str, Any]) -> None:
    """Decode normalized integers, and make a fan of what was read as a strip."""
    if positions.get("normalized"):
        mesh.vertices = np.maximum(mesh.vertices / _TYPES[positions["componentType"]][1], -1.0)
    if primitive.get("mode") == _FAN and len(mesh.faces):
        faces = np.array(mesh.faces)
        faces[1::2] = faces[1::2, ::-1]
        faces[:, 0] = faces[0, 0]
        mesh.faces = faces
    if len(mesh.faces) and mesh.faces.max() >= len(mesh.vertices):
        raise ValueError("a face has a vertex that is not there")


def _binary(data: bytes, start: int) -> bytes:
    """The buffer in a binary file; empty where there is none."""
    if data[:4] != b"glTF" or len(data) <= start:
        return b""
    end = start + 8 + int.from_bytes(data[start : start + 4], "little")
    if data[start + 4 : start + 8] != b"BIN\0" or end > len(data):
        raise ValueError("it is cut off")
    return data[start + 8 : end]


def _buffer(content: dict[str, Any], index: int, binary: bytes, folder: Path) -> bytes:
    """The bytes of a buffer: those of the binary file, in the JSON, or of another file."""
    name = None if index == 0 and binary else item(content, "buffers", index).get("uri", "data:,")
    if name is None:
        return binary
    if name.startswith("data:"):
        return base64.b64decode(name.partition(",")[2])
    name = urllib.parse.unquote(name)
    if leads_outside(folder, name):
        raise ValueError(f"it names the file {name[:200]!r}, outside of its folder")
    return read_limited(folder / name, MOST_BYTES)


def _plain(content: dict[str, Any]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The triangles of a file in a document that trimesh reads without fault.

    Returns:
        A glTF document whose meshes have one primitive each, with positions in accessor 2 i and indices in
        2 i + 1, and whose buffers are named by their numbers; the primitives.
    """
    nodes, roots = content.get("nodes", []), scene_roots(content)
    primitives: list[dict[str, Any]] = []
    of_mesh: list[range] = []
    for mesh in content.get("meshes", []):
        first = len(primitives)
        primitives += [
            entry
            for entry in mesh["primitives"]
            if entry.get("mode", _TRIANGLES) >= _TRIANGLES and "POSITION" in entry["attributes"]
        ]
        of_mesh.append(range(first, len(primitives)))
    if len(primitives) > MOST_NODES:
        raise ValueError(f"its meshes have {len(primitives):,} pieces, which are too many")
    for user in (*nodes, *primitives, *content.get("bufferViews", [])):
        for name in user.get("extensions", ()):
            if any(word in name for word in _UNREADABLE):
                raise ValueError(f"it is compressed or repeats meshes by {name}, which is not read here")
    meshes: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, Any]] = []
    for number, entry in enumerate(primitives):
        simple = {
            "attributes": {"POSITION": 2 * number},
            "mode": min(entry.get("mode", _TRIANGLES), _FAN - 1),
        }
        if "indices" in entry:
            simple["indices"] = 2 * number + 1
        meshes.append({"name": str(number), "primitives": [simple]})
        for index, is_index in ((entry["attributes"]["POSITION"], False), (entry.get("indices"), True)):
            accessor, view = _accessor(content, index, is_index)
            accessors.append({**accessor, "bufferView": len(views)})
            views.append(view)
    rows = [
        first["count"] + second["count"]
        for first, second in zip(accessors[::2], accessors[1::2], strict=True)
    ]
    placed = [{key: node[key] for key in PLACEMENT if key in node} for node in nodes]
    total = sum(rows) + sum(view["byteLength"] // _ROW for view in views)
    for node, copy in zip(nodes, placed[:], strict=True):
        drawn = item({"meshes": of_mesh}, "meshes", node["mesh"]) if "mesh" in node else ()
        copy["children"] = [*node.get("children", []), *range(len(placed), len(placed) + len(drawn))]
        placed += [{"mesh": number} for number in drawn]
        total += sum(rows[number] for number in drawn)
        if len(placed) > MOST_NODES or total * _ROW > MOST_BYTES:
            raise ValueError("its nodes are too many, or its meshes too large")
    if not any("mesh" in node for node in placed):
        raise ValueError("it holds no triangles")
    used = sorted({view["buffer"] for view in views})
    document = {
        "scenes": [{"nodes": roots}],
        "nodes": placed,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": [{**view, "buffer": used.index(view["buffer"])} for view in views],
        "buffers": [{"uri": str(index)} for index in used],
    }
    return document, primitives


def _accessor(
    content: dict[str, Any], index: int | None, is_index: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """An accessor, or an empty one, and a view of its bytes alone."""
    if index is None:
        return {"componentType": 5125, "count": 0, "type": "SCALAR"}, {"buffer": 0, "byteLength": 0}
    accessor = item(content, "accessors", index)
    kind, count = accessor["componentType"], accessor["count"]
    if accessor["type"] != ("SCALAR" if is_index else "VEC3") or kind not in (
        _INDICES if is_index else _POSITIONS
    ):
        raise ValueError("an accessor has another type than its use needs")
    if "bufferView" not in accessor or accessor.get("sparse"):
        raise ValueError("it has sparse accessors, which are not read here")
    view = item(content, "bufferViews", accessor["bufferView"])
    width = _TYPES[kind][0] * (1 if is_index else 3)
    stride = view.get("byteStride", width)
    length = stride * (count - 1) + width if count else 0
    if stride < width or accessor.get("byteOffset", 0) + length > view["byteLength"]:
        raise ValueError("a buffer is cut off")
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    simple = {"buffer": view["buffer"], "byteOffset": start, "byteLength": length, "byteStride": stride}
    kept = ("componentType", "count", "type", "normalized")
    return {key: accessor[key] for key in kept if key in accessor}, simple
