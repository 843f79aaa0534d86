# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh file is one solid for Blender's importers and for the engine, which asks them: the one it was made of."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion

from fipt_blender.blend.capture import mesh_reading
from fipt_blender.core.capture.mesh_file import read_mesh
from samples import mesh_writers
from samples.combinations import pairs
from samples.mesh_writers import CONVEX, Gltf, GltfStyle, ObjStyle, PlyStyle, Solid, together
from samples.refusals import error_of

OUTLINES = tuple(mesh_writers.outlines(np.random.default_rng(0)))


@pytest.fixture
def drawn(request: pytest.FixtureRequest) -> np.random.Generator:
    """Other random numbers for each case."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


def made(name: str, rng: np.random.Generator) -> Solid:
    """A prism over an outline, turned at random, whose caps begin at a random corner."""
    outline = mesh_writers.outlines(rng)[name]
    solid = mesh_writers.prism(outline, rng.uniform(0.5, 2.0), int(rng.integers(len(outline))))
    return solid.placed(mesh_writers.rotation(rng))


def of_blender(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles as the Blender that reads for the engine finds them."""
    mesh_reading.read(path, path.with_suffix(".npz"))
    bpy.data.batch_remove(bpy.data.objects)
    with np.load(path.with_suffix(".npz")) as found:
        return found["vertices"], found["triangles"]


def check_file(path: Path, solid: Solid, exact: float = 2e-5, read: Callable[[Path], Any] = of_blender) -> None:
    """The solid is found: its triangles, area, volume and bounds, all within `exact` of its size."""
    vertices, triangles = read(path)
    found = Solid(vertices[np.unique(triangles)], np.searchsorted(np.unique(triangles), triangles).tolist())
    assert len(triangles) == solid.triangle_count, len(triangles)
    np.testing.assert_allclose(found.figures, solid.figures, atol=exact * np.abs(solid.figures).max())


def test_the_engine_asks_a_blender_of_its_own(tmp_path: Path, drawn: np.random.Generator) -> None:
    solid, file = made("box", drawn), Gltf()
    mesh, decode = file.add_mesh(solid, GltfStyle())
    file.write(tmp_path / "room.glb", [{"mesh": mesh, **node_of(decode)}], scenes=[{"nodes": [0]}])
    check_file(tmp_path / "room.glb", solid, read=read_mesh)
    assert error_of(read_mesh, tmp_path / "gone.obj").code == "mesh-missing"
    (tmp_path / "room.xyz").write_text("0 0 0")
    assert error_of(read_mesh, tmp_path / "room.xyz").code == "mesh-format"


@pytest.mark.parametrize(
    ("outline", "blank", "negative", "apart"), pairs(OUTLINES, (" ", "\t", " \t "), (False, True), (False, True))
)
def test_obj(tmp_path: Path, drawn: np.random.Generator, outline: str, blank: str, negative: bool, apart: bool):
    style = ObjStyle(
        blank,
        negative,
        str(drawn.choice(["v", "v/t", "v//n", "v/t/n"])),
        apart,
        bool(drawn.integers(2)),
        str(drawn.choice(["", "o object {0}", "g group {0}\nusemtl m{0}", "s 1", "# face {0}"])),
        str(drawn.choice(["\n", "\r\n"])),
    )
    solid = together([made(outline, drawn), made(str(drawn.choice(OUTLINES)), drawn)])
    mesh_writers.write_obj(tmp_path / "room.obj", solid, style)
    check_file(tmp_path / "room.obj", solid)


@pytest.mark.parametrize(
    ("outlines", "order", "extra"),
    pairs([*((name,) for name in OUTLINES), ("box", "star", "triangle")], ("", "<", ">"), (False, True)),
)
def test_ply(tmp_path: Path, drawn: np.random.Generator, outlines: tuple, order: str, extra: bool) -> None:
    style = PlyStyle(
        order,
        str(drawn.choice(["float", "double"])),
        str(drawn.choice(["vertex_indices", "vertex_index"])),
        str(drawn.choice(["uchar", "int"])),
        str(drawn.choice(["int", "uint", "ushort"])),
        extra,
        end=str(drawn.choice(["\n", "\r\n"])) if not order else "\n",
    )
    solid = together([made(name, drawn) for name in outlines])
    mesh_writers.write_ply(tmp_path / "room.ply", solid, style)
    check_file(tmp_path / "room.ply", solid)


@pytest.mark.parametrize(("outline", "order"), [*zip(CONVEX, ["", "<", ">"], strict=True)])
def test_strips_of_ply(tmp_path: Path, drawn: np.random.Generator, outline: str, order: str) -> None:
    solid = made(outline, drawn)
    mesh_writers.write_ply(tmp_path / "room.ply", solid, PlyStyle(order, count="int", strips=True))
    check_file(tmp_path / "room.ply", solid)


@pytest.mark.parametrize("text, end", [(False, ""), (True, "\n"), (True, "\r\n")])
def test_stl(tmp_path: Path, drawn: np.random.Generator, text: bool, end: str) -> None:
    solid = together([made(outline, drawn) for outline in CONVEX]).triangulated()
    mesh_writers.write_stl(tmp_path / "room.stl", solid, text, end)
    check_file(tmp_path / "room.stl", solid)


STYLES = [
    *(GltfStyle(mode, indexed) for mode in (4, 5, 6) for indexed in (False, True)),
    *(GltfStyle(mode, True, index, stride=20) for mode in (4, 5, 6) for index in ("|u1", "<u4")),
    *(GltfStyle(4, True, "<u2", kind, flag) for kind in ("|i1", "|u1", "<i2", "<u2") for flag in (False, True)),
]
# Of a solid's size: float32, and positions of 8 and 16 bits.
EXACT = {"<f4": 2e-5, "|i1": 2e-2, "|u1": 2e-2, "<i2": 1e-4, "<u2": 1e-4}
KINDS = {
    "scaled": (0.7, 1.6, 1.2),
    "mirrored": (1.0, -1.0, 1.0),
    "mirrored twice": (-1.0, 1.5, -2.0),
    "inside out": (-1.3, -0.6, -0.9),
}


def node_of(matrix: np.ndarray) -> dict:
    return {"matrix": matrix.T.reshape(-1).tolist()}


def drawn_node(rng: np.random.Generator, kind: str) -> tuple[dict, np.ndarray]:
    """A node of a kind of placement, and its matrix (4, 4)."""
    place, turn, scale = rng.uniform(-2.0, 2.0, 3), rng.normal(size=4), KINDS[kind]
    turn /= np.linalg.norm(turn)
    matrix = np.array(Matrix.LocRotScale(place, Quaternion(turn.tolist()), scale))
    if rng.integers(2):
        return node_of(matrix), matrix
    rotation = [*turn[1:].tolist(), float(turn[0])]
    return {"translation": place.tolist(), "rotation": rotation, "scale": list(scale)}, matrix


@pytest.mark.parametrize(("style", "suffix"), [*zip(STYLES, [".glb", ".gltf"] * 10, strict=True)], ids=str)
def test_primitives_of_gltf(tmp_path: Path, drawn: np.random.Generator, style: GltfStyle, suffix: str) -> None:
    file, solids, nodes = Gltf(), [], []
    for name in CONVEX:
        solids.append(made(name, drawn))
        mesh, decode = file.add_mesh(solids[-1], style)
        nodes.append({"mesh": mesh, **node_of(decode)})
    file.write(tmp_path / f"room{suffix}", nodes, scenes=[{"nodes": [0, 1, 2]}])
    check_file(tmp_path / f"room{suffix}", together(solids), EXACT[style.position])


@pytest.mark.parametrize("parent, child", [*itertools.product(KINDS, KINDS)])
def test_nodes_of_gltf(tmp_path: Path, drawn: np.random.Generator, parent: str, child: str) -> None:
    """A parent, which may have a camera or lines, with a child and a second instance of the child's mesh."""
    file, solid = Gltf(), made(str(drawn.choice(CONVEX)), drawn)
    style = STYLES[int(drawn.integers(len(STYLES)))]
    mesh, decode = file.add_mesh(solid, style)
    (above, outer), (below, inner), (beside, other) = (drawn_node(drawn, kind) for kind in (parent, child, child))
    nodes = [{**above, "children": [1, 2]}, {**below, "children": [3]}, {**beside, "children": [4]}]
    nodes += [{"mesh": mesh, **node_of(decode)}, {"mesh": mesh, **node_of(decode)}]
    more: dict = {}
    if drawn.integers(2):
        more["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
        nodes[int(drawn.integers(2))]["camera"] = 0
    else:
        lines, _ = file.add_mesh(solid, GltfStyle(4))
        for primitive in file.content["meshes"][lines]["primitives"]:
            primitive["mode"] = int(drawn.choice([0, 2, 3]))
        nodes[int(drawn.integers(2))]["mesh"] = lines
    path = tmp_path / str(drawn.choice(["room.glb", "room.gltf"]))
    file.write(path, nodes, scene=0, scenes=[{"nodes": [0]}], **more)
    both = together([solid.placed(outer @ inner), solid.placed(outer @ other)])
    check_file(path, both, EXACT[style.position])


@pytest.mark.parametrize("scene", [None, 0, 1])
@pytest.mark.parametrize("others", ["", "camera", "mesh"])
def test_scenes_of_gltf(tmp_path: Path, drawn: np.random.Generator, scene: int | None, others: str) -> None:
    """A file whose meshes are not all in its scene is refused, as Blender imports all of them."""
    file, solid = Gltf(), made("box", drawn)
    nodes: list[dict] = [{"mesh": file.add_mesh(solid, GltfStyle())[0]}, {"name": "empty"}]
    more: dict = {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": scene}
    if scene is None:
        more = {"scenes": [{"nodes": [0]}]}
    nodes[1] |= {others: 0} if others else {}
    if others == "camera":
        more["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    path = tmp_path / "room.glb"
    file.write(path, nodes, **more)
    if scene == 1 or others == "mesh":
        error = error_of(of_blender, path)
        assert error.code == "mesh-unreadable" and "several scenes" in error.text
    else:
        check_file(path, solid)
    file.write(path, nodes[:1])
    check_file(path, solid)
