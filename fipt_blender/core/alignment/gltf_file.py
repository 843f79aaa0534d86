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
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..run.documents import read_limited
from ..run.kinds import as_json
from ..run.paths import leads_outside
from .gltf_document import (
    Accessor,
    Attributes,
    BufferView,
    Document,
    Mesh,
    Named,
    Node,
    Primitive,
    Scene,
    item,
    read_document,
    scene_roots,
)

if TYPE_CHECKING:
    import trimesh

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
    document, end = read_document(path)
    binary = _binary(read_limited(path, MOST_BYTES), end)
    plain, primitives, used = _plain(document)
    buffers = {str(index): _buffer(document, index, binary, path.parent) for index in used}
    text = json.dumps(plain, default=as_json)
    scene = load_scene(text.encode(), "gltf", resolver=buffers, skip_materials=True)
    for name, mesh in scene.geometry.items():
        _correct(mesh, primitives[int(name)], plain.accessors[2 * int(name)])
    whole = scene.to_mesh()
    return np.array(whole.vertices, np.float64), np.array(whole.faces, np.int64)


def load_scene(data: bytes, kind: str, **options: Any) -> trimesh.Scene:
    """A file as trimesh reads it, with all vertices as they are.

    Raises:
        ValueError: trimesh or numpy fails.
    """
    import trimesh  # here: it takes as long to load as all else that reads captures

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # numpy's at text that is no number
            return trimesh.load_scene(io.BytesIO(data), kind, process=False, **options)
    except Exception as error:  # of any kind, at damaged files
        raise ValueError(str(error) or type(error).__name__) from None


def _correct(mesh: trimesh.Trimesh, primitive: Primitive, positions: Accessor) -> None:
    """Decode normalized integers, and make a fan of what was read as a strip."""
    if positions.normalized:
        mesh.vertices = np.maximum(mesh.vertices / _TYPES[positions.componentType][1], -1.0)
    if primitive.mode == _FAN and len(mesh.faces):
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


def _buffer(document: Document, index: int, binary: bytes, folder: Path) -> bytes:
    """The bytes of a buffer: those of the binary file, in the JSON, or of another file."""
    name = None if index == 0 and binary else item(document, "buffers", index).uri or "data:,"
    if name is None:
        return binary
    if name.startswith("data:"):
        return base64.b64decode(name.partition(",")[2])
    name = urllib.parse.unquote(name)
    if leads_outside(folder, name):
        raise ValueError(f"it names the file {name[:200]!r}, outside of its folder")
    return read_limited(folder / name, MOST_BYTES)


def _plain(document: Document) -> tuple[Document, list[Primitive], list[int]]:
    """The triangles of a file in a document that trimesh reads without fault.

    Returns:
        A document whose meshes have one primitive each, with positions in accessor 2 i and indices in
        2 i + 1, and whose buffers are named by their numbers; the primitives; those numbers.
    """
    nodes, roots = document.nodes, scene_roots(document)
    primitives: list[Primitive] = []
    of_mesh: list[range] = []
    for mesh in document.meshes:
        first = len(primitives)
        primitives += [
            entry
            for entry in mesh.primitives
            if entry.mode >= _TRIANGLES and entry.attributes.POSITION is not None
        ]
        of_mesh.append(range(first, len(primitives)))
    if len(primitives) > MOST_NODES:
        raise ValueError(f"its meshes have {len(primitives):,} pieces, which are too many")
    extended: tuple[Node | Primitive | BufferView, ...] = (*nodes, *primitives, *document.bufferViews)
    for name in (name for user in extended for name in user.extensions):
        if any(word in name for word in _UNREADABLE):
            raise ValueError(f"it is compressed or repeats meshes by {name}, which is not read here")
    meshes: list[Mesh] = []
    accessors: list[Accessor] = []
    views: list[BufferView] = []
    for number, entry in enumerate(primitives):
        indices = None if entry.indices is None else 2 * number + 1
        simple = Primitive(Attributes(2 * number), indices, min(entry.mode, _FAN - 1))
        meshes.append(Mesh((simple,), str(number)))
        for index, is_index in ((entry.attributes.POSITION, False), (entry.indices, True)):
            accessor, view = _accessor(document, index, is_index)
            accessors.append(replace(accessor, bufferView=len(views)))
            views.append(view)
    rows = [first.count + second.count for first, second in zip(accessors[::2], accessors[1::2], strict=True)]
    placed: list[Node] = []
    drawn: list[Node] = []
    total = sum(rows) + sum(view.byteLength // _ROW for view in views)
    for node in nodes:
        if node.mesh is not None and node.mesh >= len(of_mesh):
            raise ValueError(f"its meshes lack number {node.mesh}")
        pieces = of_mesh[node.mesh] if node.mesh is not None else ()
        own = range(len(nodes) + len(drawn), len(nodes) + len(drawn) + len(pieces))
        placed.append(replace(node, mesh=None, extensions={}, children=(*node.children, *own)))
        drawn += [Node(mesh=number) for number in pieces]
        total += sum(rows[number] for number in pieces)
        if len(nodes) + len(drawn) > MOST_NODES or total * _ROW > MOST_BYTES:
            raise ValueError("its nodes are too many, or its meshes too large")
    if not drawn:
        raise ValueError("it holds no triangles")
    used = sorted({view.buffer for view in views})
    plain = Document(
        scenes=(Scene(tuple(roots)),),
        nodes=(*placed, *drawn),
        meshes=tuple(meshes),
        accessors=tuple(accessors),
        bufferViews=tuple(replace(view, buffer=used.index(view.buffer)) for view in views),
        buffers=tuple(Named(str(index)) for index in used),
    )
    return plain, primitives, used


def _accessor(document: Document, index: int | None, is_index: bool) -> tuple[Accessor, BufferView]:
    """An accessor, or an empty one, and a view of its bytes alone."""
    if index is None:
        return Accessor(5125, 0, "SCALAR"), BufferView(0, 0)
    accessor: Accessor = item(document, "accessors", index)
    kind, count = accessor.componentType, accessor.count
    if accessor.type != ("SCALAR" if is_index else "VEC3") or kind not in (
        _INDICES if is_index else _POSITIONS
    ):
        raise ValueError("an accessor has another type than its use needs")
    if accessor.bufferView is None or accessor.sparse:
        raise ValueError("it has sparse accessors, which are not read here")
    view: BufferView = item(document, "bufferViews", accessor.bufferView)
    width = _TYPES[kind][0] * (1 if is_index else 3)
    stride = width if view.byteStride is None else view.byteStride
    length = stride * (count - 1) + width if count else 0
    if stride < width or accessor.byteOffset + length > view.byteLength:
        raise ValueError("a buffer is cut off")
    simple = BufferView(view.buffer, length, view.byteOffset + accessor.byteOffset, stride)
    return replace(accessor, byteOffset=0), simple
