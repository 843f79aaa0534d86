"""Mesh files as the Blender that reads for the engine finds them: one of each format, and glTF's nodes and scenes."""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion

from fipt_blender.blend.capture import mesh_reading
from fipt_blender.core.capture.mesh_file import read_mesh
from samples.refusals import error_of

# A box of 3 x 2 x 1 metres, whose faces are counter-clockwise seen from outside.
CORNERS = np.array(list(itertools.product((0.0, 3.0), (0.0, 2.0), (0.0, 1.0))))
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([corners for a, b, c, d in FACES for corners in ((a, b, c), (a, c, d))])
VOLUME = 6.0  # m³


def of_blender(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a file."""
    mesh_reading.read(path, path.with_suffix(".npz"))
    bpy.data.batch_remove(bpy.data.objects)
    with np.load(path.with_suffix(".npz")) as found:
        return found["vertices"], found["triangles"]


def check(path: Path, *matrices: np.ndarray, read: Callable[[Path], tuple] = of_blender) -> None:
    """A file holds the box once for each of these matrices (4, 4), facing outwards, in its own coordinates."""
    vertices, triangles = read(path)
    assert len(triangles) == len(TRIANGLES) * len(matrices)
    volume = np.linalg.det(vertices[triangles]).sum() / 6.0
    assert volume == pytest.approx(VOLUME * sum(abs(np.linalg.det(matrix[:3, :3])) for matrix in matrices), rel=1e-4)
    places = np.concatenate([CORNERS @ matrix[:3, :3].T + matrix[:3, 3] for matrix in matrices])
    np.testing.assert_allclose(vertices.min(axis=0), places.min(axis=0), atol=1e-4)
    np.testing.assert_allclose(vertices.max(axis=0), places.max(axis=0), atol=1e-4)


def write_text(path: Path) -> None:
    """The box as OBJ or PLY with quads, or as STL."""
    if path.suffix == ".obj":
        lines = ["v {} {} {}".format(*corner) for corner in CORNERS]
        lines += ["f " + " ".join(str(index + 1) for index in face) for face in FACES]
    elif path.suffix == ".ply":
        lines = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz")]
        lines += ["element face 6", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(map(str, row)) for row in [*CORNERS.tolist(), *((4, *face) for face in FACES)]]
    else:
        lines = ["solid box"]
        for triangle in CORNERS[TRIANGLES]:
            lines += ["facet normal 0 0 0", "outer loop", *("vertex {} {} {}".format(*corner) for corner in triangle)]
            lines += ["endloop", "endfacet"]
        lines.append("endsolid box")
    path.write_text("\n".join([*lines, ""]))


def write_gltf(path: Path, nodes: list[dict], **more: object) -> None:
    """A glTF file whose mesh 0 is the box; a .gltf has its buffer beside it."""
    points, indices = CORNERS.astype("<f4"), TRIANGLES.astype("<u2")
    binary = points.tobytes() + indices.tobytes()
    bounds = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": indices.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": 5123, "count": indices.size, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": nodes,
        **more,
    }
    if path.suffix == ".gltf":
        path.with_name("the buffer.bin").write_bytes(binary)
        content["buffers"][0]["uri"] = "the%20buffer.bin"
        path.write_text(json.dumps(content))
        return
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def test_the_engine_asks_a_blender_of_its_own(tmp_path: Path) -> None:
    write_text(tmp_path / "room.stl")  # conftest.py spares OBJ and PLY files one
    check(tmp_path / "room.stl", np.eye(4), read=read_mesh)
    assert error_of(read_mesh, tmp_path / "gone.obj").code == "mesh-missing"
    (tmp_path / "room.xyz").write_text("0 0 0")
    assert error_of(read_mesh, tmp_path / "room.xyz").code == "mesh-format"


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_coordinates_of_a_map_keep_their_last_places(tmp_path: Path, suffix: str) -> None:
    path, far = tmp_path / f"room{suffix}", np.array([500_000.0, 4_600_000.0, 100.0])
    write_text(path)
    lines = [line.split() for line in path.read_text().splitlines()]
    start = 0 if suffix == ".obj" else 9  # the first vertex
    for words in lines[start : start + 8]:
        words[-3:] = [repr(float(word) + shift) for word, shift in zip(words[-3:], far, strict=True)]
    path.write_text("\n".join([*map(" ".join, lines), ""]))
    vertices, _ = of_blender(path)
    np.testing.assert_allclose(np.unique(vertices, axis=0), CORNERS + far, rtol=0, atol=1e-5)


KINDS = {"scaled": (0.7, 1.6, 1.2), "mirrored": (1.0, -1.0, 1.0), "inside out": (-1.3, -0.6, -0.9)}


@pytest.mark.parametrize(("parent", "child"), itertools.product(KINDS, KINDS))
def test_nodes_of_gltf(tmp_path: Path, parent: str, child: str) -> None:
    """A parent with a child and a second instance of the child's mesh."""
    rng, nodes, matrices = np.random.default_rng(len(parent) + 9 * len(child)), [], []
    for kind in (parent, child, child):
        place, turn = rng.uniform(-2.0, 2.0, 3).tolist(), Quaternion(rng.normal(size=4)).normalized()
        matrices.append(np.array(Matrix.LocRotScale(place, turn, KINDS[kind])))
        rotation = [turn.x, turn.y, turn.z, turn.w]
        nodes.append({"translation": place, "rotation": rotation, "scale": KINDS[kind], "mesh": 0})
    del nodes[0]["mesh"]
    path = tmp_path / ("room.glb" if parent == child else "room.gltf")
    write_gltf(path, [{**nodes[0], "children": [1, 2]}, *nodes[1:]], scenes=[{"nodes": [0]}])
    check(path, *(matrices[0] @ matrix for matrix in matrices[1:]))


@pytest.mark.parametrize("others", [{}, {"camera": 0}, {"mesh": 0}])
@pytest.mark.parametrize("scene", [0, 1])
def test_scenes_of_gltf(tmp_path: Path, scene: int, others: dict) -> None:
    """A file whose meshes are not all in its scene is refused, as Blender imports all of them."""
    camera = {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}
    path, scenes = tmp_path / "room.glb", [{"nodes": [0]}, {"nodes": [1]}]
    write_gltf(path, [{"mesh": 0}, {"name": "empty", **others}], scenes=scenes, scene=scene, cameras=[camera])
    if scene == 1 or "mesh" in others:
        error = error_of(of_blender, path)
        assert error.code == "mesh-unreadable" and "several scenes" in error.text
    else:
        check(path, np.eye(4))
