# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed solids with known area and volume, written as mesh files in all ways that programs write them."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Solid:
    """A closed surface of plane polygons that face outwards.

    Attributes:
        vertices: (V, 3) float64.
        faces: vertex indices of each polygon.
    """

    vertices: np.ndarray
    faces: list[list[int]]

    def placed(self, matrix: np.ndarray) -> Solid:
        """The solid moved by a 4x4 matrix, still facing outwards."""
        vertices = self.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        return Solid(vertices, [face[::-1] if mirrored else face for face in self.faces])

    def triangulated(self) -> Solid:
        """The same with a new vertex in the middle of each polygon; of convex polygons."""
        vertices, faces = list(self.vertices), []
        for face in self.faces:
            faces += [[face[i - 1], face[i], len(vertices)] for i in range(len(face))]
            vertices.append(self.vertices[face].mean(axis=0))
        return Solid(np.array(vertices), faces)

    @property
    def figures(self) -> np.ndarray:
        """(8,) area, volume, lowest and highest coordinates: by the area vectors of the polygons."""
        area = volume = 0.0
        for face in self.faces:
            points = self.vertices[face]
            vector = 0.5 * np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
            area += float(np.linalg.norm(vector))
            volume += float(points[0] @ vector) / 3.0
        return np.array([area, volume, *self.vertices.min(axis=0), *self.vertices.max(axis=0)])

    @property
    def triangle_count(self) -> int:
        """Of any triangulation without new vertices."""
        return sum(len(face) - 2 for face in self.faces)


def together(solids: list[Solid]) -> Solid:
    faces, count = [], 0
    for solid in solids:
        faces += [[count + index for index in face] for face in solid.faces]
        count += len(solid.vertices)
    return Solid(np.concatenate([solid.vertices for solid in solids]), faces)


def prism(outline: np.ndarray, height: float, first: int = 0) -> Solid:
    """A prism over a counterclockwise outline (n, 2); its caps begin at the corner `first`."""
    count = len(outline)
    low, high = np.insert(outline, 2, 0.0, axis=1), np.insert(outline, 2, height, axis=1)
    ring = np.roll(np.arange(count), -first)
    sides = [[i, (i + 1) % count, count + (i + 1) % count, count + i] for i in range(count)]
    return Solid(np.concatenate([low, high]), [ring[::-1].tolist(), (count + ring).tolist(), *sides])


def outlines(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Outlines (n, 2) of each kind, counterclockwise, of one metre and more."""
    angles = np.linspace(0.0, 2.0 * np.pi, 9, endpoint=False)
    wild = np.sort(rng.uniform(0.0, 2.0 * np.pi, 12)) + 0.2 * np.arange(12)
    wild *= 2.0 * np.pi / (wild[-1] + 0.3)
    teeth = [(4.0 - 0.5 * i, 0.3 if i % 2 else 2.0) for i in range(9)]
    found = {
        "triangle": np.array([[0, 0], [2, 0.3], [0.4, 1.7]]),
        "box": np.array([[0, 0], [3, 0], [3, 2], [0, 2]]),
        "arrow": np.array([[0, 0], [3, 1], [0, 2], [0.8, 1]]),
        "round": np.stack([2.0 * np.cos(angles), np.sin(angles)], axis=1),
        "angle": np.array([[0, 0], [4, 0], [4, 1], [1.5, 1], [1.5, 3], [0, 3]]),
        "middles": np.array([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 1]]),
        "star": rng.uniform(0.5, 2.0, (12, 1)) * np.stack([np.cos(wild), np.sin(wild)], axis=1),
        "comb": np.array([(0, 0), (4, 0), *teeth]),
        "spiral": np.array(
            [(0, 0), (5, 0), (5, 5), (1, 5), (1, 2), (3, 2), (3, 3), (2, 3), (2, 4), (4, 4), (4, 1), (0, 1)]
        ),
    }
    return {name: np.asarray(outline, np.float64) for name, outline in found.items()}


CONVEX = ("triangle", "box", "round")


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation (4, 4) with a shift of some metres."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.sign(np.linalg.det(axes))
    matrix[:3, 3] = rng.uniform(-3.0, 3.0, 3)
    return matrix


@dataclass(frozen=True)
class ObjStyle:
    """How an OBJ file is written."""

    blank: str = " "  # between words
    negative: bool = False  # indices count back from the last vertex
    corner: str = "v"  # or "v/t", "v//n" or "v/t/n"
    apart: bool = False  # each face follows its own vertices, which it does not share
    wrapped: bool = False  # lines end with a backslash and go on
    extra: str = ""  # text between the lines, such as groups
    end: str = "\n"  # of lines


def write_obj(path: Path, solid: Solid, style: ObjStyle) -> None:
    position = [style.blank.join(["v", *(f"{value:.9g}" for value in vertex)]) for vertex in solid.vertices]
    lines = ["# made by a test", style.blank.join(["vt", "0", "1"]), style.blank.join(["vn", "0", "0", "1"])]
    lines += [] if style.apart else position
    written = 0 if style.apart else len(position)
    for number, face in enumerate(solid.faces):
        lines += [style.extra.format(number)] if style.extra else []
        indices = [index + 1 for index in face]
        if style.apart:
            lines += [position[index] for index in face]
            indices = list(range(written + 1, written + 1 + len(face)))
            written += len(face)
        if style.negative:
            indices = [index - written - 1 for index in indices]
        texture, normal = ("-1", "-1") if style.negative else ("1", "1")
        words = [style.corner.replace("t", texture).replace("n", normal).replace("v", str(index)) for index in indices]
        joint = f"{style.blank}\\{style.end}{style.blank}" if style.wrapped else style.blank
        lines.append(style.blank.join(["f", words[0], words[1], joint.join(words[2:])]))
    path.write_bytes((style.end.join([*lines, ""])).encode())


@dataclass(frozen=True)
class PlyStyle:
    """How a PLY file is written."""

    order: str = "<"  # of bytes, or ">"; "" for ASCII
    number: str = "float"  # type of coordinates
    name: str = "vertex_indices"  # of the list of indices
    count: str = "uchar"  # type of its length
    index: str = "int"  # type of its items
    extra: bool = False  # vertices have colours, faces a quality before and another list behind the indices
    strips: bool = False  # the faces are one list of strips
    end: str = "\n"  # of the header's and of ASCII lines


_CODES = {"uchar": "B", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


def write_ply(path: Path, solid: Solid, style: PlyStyle) -> None:
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[style.order]
    header = ["ply", f"format {kind} 1.0", "comment made by a test", f"element vertex {len(solid.vertices)}"]
    colors = [f"property uchar {name}" for name in ("red", "green", "blue")] if style.extra else []
    header += [*(f"property {style.number} {axis}" for axis in "xyz"), *colors]
    vertex = _CODES[style.number] * 3 + ("BBB" if style.extra else "")
    records = [(vertex, [*point, *((1, 200, 3) if style.extra else ())]) for point in solid.vertices]
    faces = [strip_of(solid.faces)] if style.strips else solid.faces
    before, behind = ("f", "Bff") if style.extra and not style.strips else ("", "")
    header.append(f"element {'tristrips' if style.strips else 'face'} {len(faces)}")
    header += ["property float quality"] if before else []
    header.append(f"property list {style.count} {style.index} {style.name}")
    header += ["property list uchar float texcoord"] if before else []
    for face in faces:
        values = [*([0.5] if before else []), len(face), *face, *((2, 0.25, 0.75) if behind else ())]
        codes = before + _CODES[style.count] + _CODES[style.index] * len(face) + behind
        records.append((codes, values))
    data = "".join(line + style.end for line in [*header, "end_header"]).encode()
    if style.order:
        data += b"".join(struct.pack(style.order + codes, *values) for codes, values in records)
    else:
        lines = [" ".join(f"{value:.9g}" for value in values) for _, values in records]
        data += "".join(line + style.end for line in lines).encode()
    path.write_bytes(data)


def strip_of(faces: list[list[int]]) -> list[int]:
    """Convex polygons as strips with a restart between them: zigzag from the first corner."""
    result: list[int] = []
    for face in faces:
        low, high, strip = 1, len(face) - 1, [face[0]]
        while low <= high:
            strip.append(face[low])
            strip += [face[high]] if high > low else []
            low, high = low + 1, high - 1
        result += [*([-1] if result else []), *strip]
    return result


def write_stl(path: Path, solid: Solid, text: bool, end: str = "\n") -> None:
    """Write an STL file of a solid of triangles."""
    corners = solid.vertices[np.array(solid.faces)].astype("<f4")
    if not text:
        records = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
        records["corners"] = corners
        path.write_bytes(b"solid of a test".ljust(80) + struct.pack("<I", len(corners)) + records.tobytes())
        return
    lines = ["solid test"]
    for triangle in corners:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += ["      vertex " + " ".join(f"{value:.9e}" for value in corner) for corner in triangle]
        lines += ["    endloop", "  endfacet"]
    path.write_bytes(end.join([*lines, "endsolid test", ""]).encode())


def glb(content: dict, binary: bytes) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@dataclass(frozen=True)
class GltfStyle:
    """How the mesh of a glTF file is written."""

    mode: int = 4  # 4, 5 or 6: triangles, strips or fans, one primitive for each face
    indexed: bool = True  # whether primitives have indices
    index: str = "<u2"  # numpy's type of indices
    position: str = "<f4"  # numpy's; integers span the solid, and the node's scale decodes them
    normalized: bool = False  # integers stand for -1 to 1, or 0 to 1
    stride: int = 0  # bytes from one position to the next; 0 where they are not interleaved


_COMPONENTS = {"|i1": 5120, "|u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}


class Gltf:
    """A glTF file that grows.

    Attributes:
        content: the JSON.
        binary: the buffer.
    """

    def __init__(self) -> None:
        self.content: dict = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": []}
        self.binary = b""

    def add_mesh(self, solid: Solid, style: GltfStyle) -> tuple[int, np.ndarray]:
        """Add a mesh of convex faces.

        Returns:
            Its number, and the matrix (4, 4) that decodes its positions.
        """
        decode, values = np.eye(4), solid.vertices
        if style.position != "<f4":
            limits = np.iinfo(style.position)
            least = -limits.max if limits.min else 0
            low, high = values.min(axis=0), values.max(axis=0)
            unit = limits.max if style.normalized else 1
            decode[:3, :3] = np.diag((high - low) / (limits.max - least) * unit)
            decode[:3, 3] = low - least / unit * np.diag(decode)[:3]
            values = np.round((values - low) / (high - low) * (limits.max - least) + least)
        primitives = []
        if style.indexed:
            position = self._accessor(values.astype(style.position), style)
        for face in solid.faces:
            corners = {4: _fan, 5: lambda face: strip_of([face]), 6: list}[style.mode](face)
            if style.indexed:
                indices = np.array(corners).astype(style.index)
                primitive = {"attributes": {"POSITION": position}, "indices": self._accessor(indices)}
            else:
                shown = self._accessor(values[corners].astype(style.position), style)
                primitive = {"attributes": {"POSITION": shown}}
            primitives.append({**primitive, **({} if style.mode == 4 else {"mode": style.mode})})
        self.content["meshes"].append({"primitives": primitives})
        if style.position != "<f4":
            for key in ("extensionsUsed", "extensionsRequired"):
                self.content[key] = ["KHR_mesh_quantization"]
        return len(self.content["meshes"]) - 1, decode

    def _accessor(self, values: np.ndarray, style: GltfStyle | None = None) -> int:
        rows = np.ascontiguousarray(values).reshape(len(values), -1).view(np.uint8).reshape(len(values), -1)
        stride = max(-(-rows.shape[1] // 4) * 4, style.stride) if style else 0
        data = np.pad(rows, ((0, 0), (0, stride - rows.shape[1]))).tobytes() if stride else rows.tobytes()
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.content["bufferViews"].append({**view, **({"byteStride": stride} if stride else {})})
        self.binary += data + b"\0" * (-len(data) % 4)
        accessor = {
            "bufferView": len(self.content["bufferViews"]) - 1,
            "componentType": _COMPONENTS[values.dtype.str],
            "count": len(values),
            "type": "VEC3" if style else "SCALAR",
        }
        if style:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        if style and style.normalized:
            accessor["normalized"] = True
        self.content["accessors"].append(accessor)
        return len(self.content["accessors"]) - 1

    def write(self, path: Path, nodes: list[dict], **more: object) -> None:
        """Write the file; a .gltf has its buffer beside it."""
        content = {**self.content, "nodes": nodes, "buffers": [{"byteLength": len(self.binary)}], **more}
        if path.suffix == ".glb":
            path.write_bytes(glb(content, self.binary))
            return
        path.with_name("the buffer.bin").write_bytes(self.binary)
        content["buffers"][0]["uri"] = "the%20buffer.bin"
        path.write_text(json.dumps(content))


def _fan(face: list[int]) -> list[int]:
    return [index for i in range(1, len(face) - 1) for index in (face[0], face[i], face[i + 1])]
