"""Meshes imported without conversion of axes, and exported evaluated and in world space."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.blend.capture import mesh_import
from fipt_blender.blend.room import exporting
from fipt_blender.core import conventions
from fipt_blender.core.run.run_files import read_room
from samples.at_once import export_room
from samples.refusals import error_of
from samples.spots import spot, white_world

# A tetrahedron-like shape without symmetry, so that any rotation or mirroring shows.
POINTS = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], np.float64)
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def write_obj(path: Path, faces=FACES) -> Path:
    lines = ["o tetra"] + ["v {} {} {}".format(*point) for point in POINTS]
    lines += ["f " + " ".join(str(index + 1) for index in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def canonical(vertices, triangles):
    """Triangles as sorted rows that begin with the lowest corner: independent of order, not of winding."""
    corners = np.round(np.asarray(vertices, np.float64)[triangles], 4) + 0.0
    rows = []
    for triangle in corners:
        start = min(range(3), key=lambda index: tuple(triangle[index]))
        rows.append(tuple(np.roll(triangle, -start, axis=0).ravel()))
    return sorted(rows)


@pytest.mark.parametrize("mirrored", [False, True])
def test_import_applies_world_from_source_and_nothing_else(tmp_path, run_folder, mirrored):
    matrix = conventions.world_from_source("y", 0.5) @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])
    matrix[:3, 3] = (1.0, 2.0, 3.0)
    names = mesh_import.import_room(write_obj(tmp_path / "a.obj"), matrix)
    item = bpy.data.objects[names[0]]
    assert item.matrix_world == Matrix.Identity(4)
    assert [each.name for each in item.users_collection] == ["Parts"]
    room = export_room([item], run_folder)
    expected = conventions.transform_points(matrix, POINTS)
    outwards = [face[::-1] for face in FACES] if mirrored else FACES
    assert canonical(room.vertices, room.triangles) == canonical(expected, outwards)


def test_import_errors(tmp_path):
    (tmp_path / "a.xyz").write_text("")
    write_obj(tmp_path / "b.obj", faces=[])
    for name, code in (("nothing.obj", "mesh-missing"), ("a.xyz", "mesh-format"), ("b.obj", "mesh-empty")):
        assert error_of(mesh_import.import_room, tmp_path / name, np.eye(4)).code == code
    assert not bpy.data.objects


def test_degenerate_and_inverted_faces_are_kept(tmp_path, run_folder):
    mesh = bpy.data.meshes.new("m")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)], [], [(0, 1, 2), (0, 3, 1)])
    item = bpy.data.objects.new("m", mesh)
    bpy.context.scene.collection.objects.link(item)
    room = export_room([item], run_folder)
    assert len(room.triangles) == 2
    assert np.isfinite(room.corner_normals).all()
    assert np.allclose(np.linalg.norm(room.corner_normals, axis=2), 1.0, atol=1e-5)
    assert room.corner_normals[1, 0, 2] == pytest.approx(-1.0)


def test_export_of_modifiers_mirrored_scale_and_materials(run_folder):
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    item = bpy.context.object
    item.scale, item.rotation_euler, item.location = (-1.0, 2.0, 0.5), Euler((0.3, 0.2, 0.1)), (4.0, 5.0, 6.0)
    item.modifiers.new("Bevel", "BEVEL").width = 0.1
    for name in ("first", "second"):
        item.data.materials.append(bpy.data.materials.new(name))
    item.data.polygons[2].material_index = 1
    bpy.context.view_layer.update()
    room = export_room([item], run_folder, parts="materials")
    assert len(room.triangles) > 12
    corners = room.vertices[room.triangles].astype(np.float64)
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - np.array(item.location)
    assert ((face * away).sum(axis=1) > 0).all()
    assert ((room.corner_normals * face[:, None]).sum(axis=2) > 0).all()
    # The sides keep their distances: a box of half sizes 1, 2, 0.5 in its own frame.
    local = (corners.reshape(-1, 3) - np.array(item.location)) @ np.array(Euler((0.3, 0.2, 0.1)).to_matrix())
    assert np.allclose(np.abs(local).max(axis=0), [1.0, 2.0, 0.5], atol=1e-5)
    assert room.materials == ("first", "second")
    assert set(np.unique(room.triangle_material)) == {0, 1}
    again = read_room(run_folder)
    assert np.array_equal(again.triangles, room.triangles) and list(again.objects) == [item.name]


def test_custom_normals_reach_the_export(run_folder):
    bpy.ops.mesh.primitive_plane_add()
    item = bpy.context.object
    tilted = np.array([math.sin(0.3), 0.0, math.cos(0.3)])
    item.data.normals_split_custom_set([tilted.tolist()] * 4)
    item.rotation_euler = (0.0, 0.0, math.pi / 2)
    bpy.context.view_layer.update()
    room = export_room([item], run_folder)
    assert np.allclose(room.corner_normals, [0.0, math.sin(0.3), math.cos(0.3)], atol=1e-3)


def test_faces_of_opposite_winding_render_alike(tmp_path):
    # Two halves of a wall share an edge; the second one has the opposite winding and normals.
    lines = [f"v {x} {y} 0" for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    lines += ["vn 0 0 1", "vn 0 0 -1", "s 1", "f 1//1 2//1 3//1", "f 1//2 4//2 3//2"]
    (tmp_path / "wall.obj").write_text("\n".join(lines))
    (name,) = mesh_import.import_room(tmp_path / "wall.obj", np.eye(4))
    mesh = bpy.data.objects[name].data
    mesh.shade_smooth()
    mesh.normals_split_custom_set([(0.0, 0.0, 1.0)] * 3 + [(0.0, 0.0, -1.0)] * 3)
    mesh_import.mark_turned_edges(mesh)
    white_world()
    image = spot((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), 16, 16, 1.6)
    assert image[..., 0].min() > 0.5 * image[..., 0].max() > 0.2


def test_objects_keep_their_ids_and_copies_get_new_ones():
    for name in ("chair", "table"):
        item = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        bpy.context.scene.collection.objects.link(item)
    chair = bpy.data.objects["chair"]
    assert exporting.give_ids(["chair", "table"]) == ["chair", "table"]
    copy = chair.copy()
    chair.name, copy.name = "seat", "another"
    assert exporting.give_ids(["seat", "another", "table"]) == ["chair", "another", "table"]
    new = bpy.data.objects.new("chair", bpy.data.meshes.new("chair"))
    bpy.context.scene.collection.objects.link(new)
    assert exporting.give_ids(["seat", "chair"]) == ["chair", "chair (2)"]
