"""Damaged mesh files are refused in words and end no Blender; what they may name; impossible vertices and paths."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path

import bpy
import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from fipt_blender.blend.capture.mesh_import import import_room
from fipt_blender.blend.capture.mesh_names import check_mesh_file
from fipt_blender.core import conventions
from samples.child_processes import PATIENCE_SECONDS, posix
from samples.fuzz import mutate
from samples.refusals import error_of

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
TRIANGLES = [(0, 1, 2), (1, 2, 3), (2, 3, 4)]
MIXED = [(0, 1, 2), (1, 2, 3, 4), (2, 3, 4)]
OBJ = b"v 0 0 0\nv 1 0 0 # x\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf -3//1 -2//1 \\\n -1//1\n"

# Imports the files of folders in Blender, and says so on stderr if it has survived them: Blender's own lines
# on stdout are buffered apart from Python's and may come after them.
IMPORT = """
import sys
import numpy as np
from pathlib import Path
from fipt_blender.blend.capture.mesh_import import import_room
from fipt_blender.core.run.errors import FiptError
for path in sorted(Path(sys.argv[1]).glob("*/*")):
    print(path, file=sys.stderr, flush=True)
    try:
        import_room(path, np.eye(4))
    except FiptError:
        pass
print("survived", file=sys.stderr, flush=True)
"""


def ply(faces=TRIANGLES, order="<", vertices=5) -> bytes:
    """A PLY file with coordinates, colours and faces; ASCII if `order` is empty."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    lines = ["ply", f"format {name} 1.0", "comment made by a test", f"element vertex {vertices}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    lines += [f"element face {len(faces)}"]
    lines += ["property list uchar int vertex_indices", "property float quality"]
    text = "\n".join([*lines, "end_header\n"])
    if not order:
        text += "".join("{} {} {} 3 200 7\n".format(*point) for point in POINTS)
        text += "".join(f"{len(face)} {' '.join(map(str, face))} 0.5\n" for face in faces)
        return text.encode()
    data = b"".join(struct.pack(order + "3f3B", *point, 3, 200, 7) for point in POINTS)
    data += b"".join(struct.pack(f"{order}B{len(face)}if", len(face), *face, 0.5) for face in faces)
    return text.encode() + data


GOOD = {"little.ply": ply(), "big.ply": ply(MIXED, ">"), "ascii.ply": ply(MIXED, ""), "room.obj": OBJ}


def problem(tmp_path: Path, name: str, content: bytes) -> str:
    path = tmp_path / name
    path.write_bytes(content)
    error = error_of(check_mesh_file, path)
    assert error.code == "mesh-unreadable" and name in error.text and error.remedy
    return error.text


def test_damaged_ply_files_end_no_blender_of_the_artists(tmp_path):
    for content in (ply()[:-20], ply(order="", vertices=10**9), b"ply\n"):
        (tmp_path / "a.ply").write_bytes(content)
        error = error_of(import_room, tmp_path / "a.ply", np.eye(4))
        assert error.code == "mesh-unreadable" and "a.ply" in error.text and error.remedy


@posix
def test_blender_survives_damaged_meshes(tmp_path):
    @hypothesis.seed(7)
    @hypothesis.settings(max_examples=8, database=None, deadline=None)
    @hypothesis.given(st.data())
    def damage(data):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        for name, content in GOOD.items():
            (folder / name).write_bytes(content)
        mutate(folder, data.draw)
        for name, content in GOOD.items():
            if (folder / name).read_bytes() == content:
                (folder / name).unlink()

    damage()
    command = [sys.executable, "-c", IMPORT, str(tmp_path)]
    root = Path(__file__).resolve().parent.parent
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=PATIENCE_SECONDS)
    assert "survived\n" in result.stderr, result.stderr[-500:]


def gltf(uri: str, kind: str = "buffers") -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, kind: [{"uri": uri, "byteLength": 36}]}).encode()


@posix
def test_meshes_name_files_of_their_folder_and_no_devices(tmp_path):
    (tmp_path / "mesh" / "tex").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(b"x")
    outside = ("../secret.bin", str(tmp_path / "secret.bin"), "%2e%2e/secret.bin", "a/../../secret.bin")
    network = ("//server/share/a.bin", "\\\\server\\share\\a.bin")
    for kind in ("buffers", "images"):
        for uri in (*outside, *network, "/dev/zero"):
            assert "outside of its folder" in problem(tmp_path / "mesh", "a.gltf", gltf(uri, kind))
            header = struct.pack("<4sIIII", b"glTF", 2, 0, len(gltf(uri, kind)), 0x4E4F534A)
            assert "outside of its folder" in problem(tmp_path / "mesh", "a.glb", header + gltf(uri, kind))
        for uri in ("a.bin", "./tex/a%20b.png", "data:application/octet-stream;base64,AAAA"):
            (tmp_path / "mesh" / "a.gltf").write_bytes(gltf(uri, kind))
            check_mesh_file(tmp_path / "mesh" / "a.gltf")
    for line in ("map_Kd /dev/zero", "map_Kd -s 1 1 1 //server/share/a.png", "bump \\\\server\\a.png"):
        (tmp_path / "mesh" / "a.mtl").write_text(f"newmtl a\n{line}\n")
        assert "outside of its folder" in problem(tmp_path / "mesh", "a.obj", b"mtllib a.mtl\n" + OBJ)
    for line in ("map_Kd ../tex/a b.png", "map_Kd C:\\textures\\a.png", f"map_Kd {tmp_path}/secret.bin"):
        (tmp_path / "mesh" / "a.mtl").write_text(f"newmtl a\n{line}\n")
        check_mesh_file(tmp_path / "mesh" / "a.obj")
    for library in ("/dev/zero", "//server/share/a.mtl"):
        content = f"mtllib {library}\n".encode() + OBJ
        assert "outside of its folder" in problem(tmp_path / "mesh", "a.obj", content)


def test_vertices_that_are_far_and_long_paths_are_told(tmp_path):
    def code(path: Path, scale: float = 1.0) -> tuple[str, str]:
        before = {item.name for item in bpy.data.objects}
        caught = error_of(import_room, path, scale * np.eye(4))
        assert {item.name for item in bpy.data.objects} == before
        return caught.code, caught.text

    (tmp_path / "a.obj").write_bytes(OBJ)
    assert code(tmp_path / "a.obj", 1e9)[0] == "mesh-not-finite"
    deep = tmp_path.joinpath(*["d" * 100] * 10)
    deep.mkdir(parents=True)
    (deep / "a.obj").write_bytes(OBJ)
    assert code(deep / "a.obj")[0] == "path-long"


@pytest.mark.parametrize("stage", ["", 'upAxis = "Y"', 'upAxis = "Z"'])
@pytest.mark.parametrize("up", ["y", "z"])
def test_usd_keeps_the_coordinates_of_its_file(tmp_path, stage, up):
    """As other formats: the capture says what is up, for cameras and mesh alike."""
    points = [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)]
    text = f"""#usda 1.0
(
 metersPerUnit = 1
 {stage}
)
def Mesh "m"
{{
 int[] faceVertexCounts = [3, 3]
 int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
 point3f[] points = {points}
}}
"""
    (tmp_path / "room.usda").write_text(text)
    world = conventions.world_from_source(up)
    (name,) = import_room(tmp_path / "room.usda", world)
    found = [tuple(round(value, 4) + 0.0 for value in vertex.co) for vertex in bpy.data.objects[name].data.vertices]
    expected = conventions.transform_points(world, np.array(points, np.float64))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_an_import_changes_nothing_of_the_scene_and_meshes_are_at_rest(tmp_path):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps = 5, 77, 9, 30
    scene.unit_settings.scale_length = 0.5
    world, worlds = scene.world, set(bpy.data.worlds)
    samples = ", ".join(f"{frame}: ({frame}, 0, 0)" for frame in range(3))
    (tmp_path / "room.usda").write_text(
        f"""#usda 1.0
(
 upAxis = "Z"
 startTimeCode = 0
 endTimeCode = 2
)
def Mesh "m"
{{
 int[] faceVertexCounts = [3]
 int[] faceVertexIndices = [0, 1, 2]
 point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 2, 0)]
 double3 xformOp:translate.timeSamples = {{ {samples} }}
 uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""
    )
    (name,) = import_room(tmp_path / "room.usda", np.eye(4))
    assert (scene.frame_start, scene.frame_end, scene.frame_current, scene.render.fps) == (5, 77, 9, 30)
    assert scene.unit_settings.scale_length == 0.5 and scene.world == world and set(bpy.data.worlds) == worlds
    item = bpy.data.objects[name]
    assert item.animation_data is None and not item.constraints and not item.modifiers
    scene.frame_set(20)
    assert item.matrix_world.is_identity


def test_line_ends_of_old_macs_are_named(tmp_path):
    assert "CR" in problem(tmp_path, "a.ply", ply(order="").replace(b"\n", b"\r"))


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_texture_basisu"])
def test_compressions_that_blender_does_not_read_are_named(tmp_path, name):
    path = tmp_path / "room.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": [name]}))
    error = error_of(check_mesh_file, path)
    assert error.code == "mesh-format" and name in error.text and "OBJ" in error.remedy
