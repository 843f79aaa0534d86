# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Result meshes of a scan: the cleaned vertices and normals in the world, whatever the object's transform."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from fipt_blender.blend.marks import ADDED, DRAWN
from fipt_blender.blend.room.arrays import Room, read_room
from fipt_blender.blend.room.cleaned import clean_result_mesh
from fipt_blender.blend.room.exporting import collect_room, export_room
from fipt_blender.blend.room.mesh_arrays import vertex_positions
from fipt_blender.blend.room.result_meshes import make_mesh
from fipt_blender.core.geometry.stored import prepare_geometry
from fipt_blender.core.run.run_files import read_geometry
from fipt_blender.core.run.runfolder import RunFolder
from samples.scans import scanned_box

TRANSFORMS = {
    "none": Matrix(),
    "turned": Matrix.LocRotScale((1.0, -2.0, 0.5), Euler((0.2, 0.4, 1.1)), (1.0, 1.0, 1.0)),
    "stretched": Matrix.Diagonal((2.0, 0.5, 1.0, 1.0)),
    "mirrored": Matrix.Diagonal((-1.0, 1.0, 1.0, 1.0)),
}


def scanned_object(run: RunFolder, matrix: Matrix) -> tuple[bpy.types.Object, Room]:
    """A scan of a box as an object of this transform, exported and cleaned."""
    scan, _ = scanned_box(cells=20, noise=0.01)
    inverse = np.array(matrix.inverted())
    mesh = bpy.data.meshes.new("Scan")
    local = scan.vertices @ inverse[:3, :3].T + inverse[:3, 3]
    mesh.from_pydata(local.tolist(), [], scan.triangles.tolist())
    item = bpy.data.objects.new("Scan", mesh)
    item.matrix_world = matrix
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    export_room([item], run)
    prepare_geometry(run)
    return item, read_room(run)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_result_meshes_of_a_scan_are_clean(tmp_path: Path, transform: str) -> None:
    run = RunFolder(tmp_path)
    item, room = scanned_object(run, TRANSFORMS[transform])
    geometry = read_geometry(run, room.mesh)
    assert geometry is not None
    own = item.data
    before = np.array([vertex.co for vertex in own.vertices])

    clean = make_mesh(room, 0, item)
    clean_result_mesh(clean, item, room, 0, geometry)

    assert np.array_equal(before, [vertex.co for vertex in own.vertices])
    item.data = clean
    shown = collect_room([item])
    assert np.array_equal(shown.triangles, room.triangles)
    assert np.abs(shown.vertices - geometry["vertices"]).max() < 1e-5
    cosine = (shown.corner_normals * geometry["corner_normals"]).sum(axis=2)
    assert np.median(cosine) > 0.9999 and np.quantile(cosine, 0.01) > 0.99


def test_a_drawn_surface_beside_a_scan_keeps_its_vertices_and_edges(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    item, _ = scanned_object(run, Matrix())
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.5 + [0.3, 0.2, 1.0]
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    mesh = bpy.data.meshes.new("Drawn")
    mesh.from_pydata(corners.tolist(), [], faces)
    drawn = bpy.data.objects.new("Drawn", mesh)
    drawn[ADDED] = DRAWN
    bpy.context.scene.collection.objects.link(drawn)
    before = collect_room([drawn])
    export_room([drawn, item], run)
    prepare_geometry(run)
    room = read_room(run)
    assert room.triangle_exact is not None and room.triangle_exact.sum() == 12
    geometry = read_geometry(run, room.mesh)
    assert geometry is not None and read_geometry(run, replace(room, triangle_exact=None).mesh) is None
    clean = make_mesh(room, 0, drawn)
    clean_result_mesh(clean, drawn, room, 0, geometry)
    drawn.data = clean
    shown = collect_room([drawn])
    assert np.abs(shown.vertices - before.vertices).max() < 1e-6
    assert np.abs(shown.corner_normals - before.corner_normals).max() < 1e-3
    clean = make_mesh(room, 1, item)
    clean_result_mesh(clean, item, room, 1, geometry)
    assert np.abs(vertex_positions(clean) - vertex_positions(item.data)).max() > 1e-3


def test_a_copy_of_another_mesh_is_not_used(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    _, room = scanned_object(run, Matrix())
    moved = {"vertices": room.vertices + np.float32(0.1), "triangles": room.triangles}
    assert read_geometry(run, moved) is None
