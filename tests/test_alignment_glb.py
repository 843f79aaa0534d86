# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of .glb files for the alignment: those that Blender exports, small ones by hand, damaged ones."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.run.errors import FiptError
from samples.mesh_writers import glb
from samples.refusals import error_of

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)


def little(**changes) -> dict:
    """Two triangles, with a stride of 16 bytes, shown twice."""
    binary = 64
    content = {
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"mesh": 0, "children": [1]},
            {"mesh": 0, "translation": [0.0, 0.0, 5.0], "scale": [2.0, 2.0, 2.0], "rotation": [0.0, 0.0, 1.0, 0.0]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": binary, "byteStride": 16},
            {"buffer": 0, "byteLength": 12, "byteOffset": binary},
        ],
    }
    return {**content, **changes}


def binary() -> bytes:
    padded = np.hstack([POINTS, np.zeros((4, 1), np.float32)]).tobytes()
    return padded + np.array([0, 1, 2, 0, 1, 3], np.uint16).tobytes()


def test_nodes_place_their_meshes(tmp_path: Path) -> None:
    path = tmp_path / "scan.glb"
    path.write_bytes(glb(little(), binary()))
    vertices, triangles = read_mesh(path)
    np.testing.assert_allclose(vertices[:4], POINTS)
    np.testing.assert_allclose(vertices[4:], 2.0 * POINTS * [-1, -1, 1] + [0, 0, 5], atol=1e-12)
    assert triangles.tolist() == [[0, 1, 2], [0, 1, 3], [4, 5, 6], [4, 5, 7]]


def test_files_of_blender(tmp_path: Path) -> None:
    """In the file's own axes: glTF is Y up."""
    parent = bpy.data.objects.new("parent", None)
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata(POINTS.tolist(), [], [(0, 1, 2), (0, 1, 3)])
    item = bpy.data.objects.new("item", mesh)
    item.parent = parent
    parent.matrix_world = Matrix.LocRotScale((1, 2, 3), Euler((0.3, 0.2, 1.0)), (2, 2, 2))
    item.matrix_local = Matrix.LocRotScale((0.1, 0.2, 0.3), Euler((1.0, -0.2, 0.4)), (1, 1, 1.5))
    for each in (parent, item):
        bpy.context.scene.collection.objects.link(each)
    bpy.context.view_layer.update()
    world = np.array([item.matrix_world @ vertex.co for vertex in mesh.vertices])
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "scan.glb"), export_format="GLB")
    vertices, triangles = read_mesh(tmp_path / "scan.glb")
    assert len(triangles) == 2
    expected = world[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    for corner in vertices[triangles.reshape(-1)]:
        assert np.abs(expected - corner).max(axis=1).min() < 1e-5


@pytest.mark.parametrize(
    "damage",
    [
        {"nodes": [{"mesh": 7}]},
        {"nodes": [{"children": [0], "mesh": 0}]},
        {"nodes": [{"children": [1]}, {"children": [0]}]},
        {"nodes": [{"mesh": 0, "children": [1, 1]}, {}]},
        {"nodes": [{"mesh": 0, "children": [1]}, {}], "scenes": [{"nodes": [0, 1]}]},
        {"nodes": [{"mesh": 0}] * 100_001, "scenes": [{"nodes": list(range(100_001))}]},
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 100_001}]},
        {"accessors": []},
        {"bufferViews": [{"buffer": 1, "byteLength": 4}] * 2},
        {"bufferViews": [{"buffer": 0, "byteLength": 4, "byteOffset": 1 << 30}] * 2},
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 1}}]}]},
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]},
        {"nodes": "none"},
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, damage: dict) -> None:
    path = tmp_path / "scan.glb"
    path.write_bytes(glb(little(**damage), binary()))
    assert error_of(read_mesh, path).code == "mesh-unreadable"


def test_any_byte_cut_off_is_refused(tmp_path: Path) -> None:
    path, whole = tmp_path / "scan.glb", glb(little(), binary())
    for length in range(0, len(whole), 37):
        path.write_bytes(whole[:length])
        with pytest.raises(FiptError):
            read_mesh(path)


@pytest.mark.parametrize(
    "owner, name",
    [
        ("primitive", "KHR_draco_mesh_compression"),
        ("view", "EXT_meshopt_compression"),
        ("view", "KHR_meshopt_compression"),
        ("node", "EXT_mesh_gpu_instancing"),
        ("sparse", "sparse"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, owner: str, name: str) -> None:
    content = little()
    extended = {
        "primitive": content["meshes"][0]["primitives"][0],
        "view": content["bufferViews"][0],
        "node": content["nodes"][0],
        "sparse": content["accessors"][0],
    }[owner]
    extended |= {"sparse": {"count": 1}} if owner == "sparse" else {"extensions": {name: {}}}
    (tmp_path / "scan.glb").write_bytes(glb(content, binary()))
    assert name in error_of(read_mesh, tmp_path / "scan.glb").text


def hostile() -> dict[str, dict]:
    """Little files that state, or repeat, far more than they hold."""
    none = {"componentType": 5126, "count": 1 << 39, "type": "VEC3"}
    accessors, views = little()["accessors"], little()["bufferViews"]
    chain = [{"children": [index + 1]} for index in range(1000)] + [{"mesh": 0}]
    return {
        "accessor": little(accessors=[{**accessors[0], "count": 1 << 39}, accessors[1]]),
        "empty accessor": little(accessors=[none, accessors[1]]),
        "unused accessor": little(accessors=[*accessors, {**none, "type": "MAT4"}]),
        "view": little(bufferViews=[{**views[0], "byteLength": 1 << 39}, views[1]]),
        "buffers": little(bufferViews=[{**views[0], "buffer": 1 << 39}, views[1]]),
        "stride": little(bufferViews=[{**views[0], "byteStride": 0}, views[1]]),
        "deep": little(nodes=chain),
    }


@pytest.mark.parametrize("kind", hostile())
def test_hostile_files_take_no_memory(tmp_path: Path, kind: str) -> None:
    (tmp_path / "scan.glb").write_bytes(glb(hostile()[kind], binary()))
    tracemalloc.start()
    try:
        read_mesh(tmp_path / "scan.glb")
    except FiptError as error:
        assert error.code == "mesh-unreadable"
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert most < 300e6
