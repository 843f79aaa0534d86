# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button Align by Points with the engine: the cameras of a solve come to a mesh of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender import machine
from fipt_blender.blend.capture.exporting import camera_pose
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from samples import rig_writers
from samples.camera_poses import look_at

pytestmark = pytest.mark.usefixtures("registered")
ops = bpy.ops.fipt
BOXES = [
    ((0, 0, 0), (5, 4, 2.6)),
    ((0, 0, 0), (0.6, 2.2, 1.9)),
    ((2.0, 1.2, 0.65), (3.6, 2.1, 0.75)),
    ((4.2, 2.6, 0), (5, 4, 0.8)),
]
POSES = [look_at([4.0, 1.0, 1.5], [1.0, 3.0, 1.0]), look_at([1.5, 3.0, 1.4], [4.0, 1.0, 1.0])]
POSES += [look_at([2.0, 2.5, 1.6], [0.0, 1.0, 1.0])]


def quads() -> np.ndarray:
    """(6 B, 4, 3) faces of the boxes."""
    faces = []
    for low, high in BOXES:
        for axis in range(3):
            for side in (low[axis], high[axis]):
                others = [a for a in range(3) if a != axis]
                face = np.full((4, 3), float(side))
                for corner, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
                    face[corner, others] = (low, high)[i][others[0]], (low, high)[j][others[1]]
                faces.append(face)
    return np.array(faces)


def write_solve(folder: Path, from_room: np.ndarray) -> None:
    """OpenSfM's cameras and 400 points on the boxes, in other coordinates."""
    rng = np.random.default_rng(0)
    faces = quads()
    sides = faces[:, [1, 3]] - faces[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    chosen = rng.choice(len(faces), 400, p=areas / areas.sum())
    points = faces[chosen, 0] + np.einsum("nk,nkc->nc", rng.random((400, 2)), sides[chosen])
    points += 0.003 * rng.normal(size=points.shape)
    (shot,) = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), 1)
    shots = []
    for index, pose in enumerate(POSES):
        solved = conventions.transform_poses(from_room, pose)
        name = f"{index}.jpg"
        shots.append(
            replace(shot, name=name, width=24, height=16, rotation=solved[:3, :3].T, centre=solved[:3, 3])
        )
        write_exr(folder / "images" / f"{index}.exr", 1.0 + rng.random((16, 24, 3), np.float32))
    moved = conventions.transform_points(from_room, points)
    rig_writers.write_opensfm(folder, [shots], "perspective", moved)


def test_cameras_come_to_an_imported_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    from_room = np.eye(4)
    from_room[:3, :3] = 0.4 * np.array(Matrix.Rotation(1.2, 3, "Z"))
    from_room[:3, 3] = (3.0, 1.0, -2.0)
    write_solve(tmp_path / "solve", from_room)
    scene = bpy.context.scene
    assert ops.import_capture(filepath=str(tmp_path / "solve")) == {"FINISHED"}
    mesh = bpy.data.meshes.new("Scan")
    corners = quads().reshape(-1, 3)
    mesh.from_pydata(corners.tolist(), [], np.arange(len(corners)).reshape(-1, 4).tolist())
    item = bpy.data.objects.new("Scan", mesh)
    scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    assert ops.set_room() == {"FINISHED"}
    assert ops.align_cameras(how="points") == {"FINISHED"}
    assert "% of the points" in scene.fipt.alignment.summary and scene.fipt.alignment.candidates
    for view, pose in zip(scene.fipt.capture.views, POSES, strict=True):
        np.testing.assert_allclose(camera_pose(view.camera_object()), pose, atol=0.01)
    assert ops.align_cameras(how="near") == {"FINISHED"}
    for view, pose in zip(scene.fipt.capture.views, POSES, strict=True):
        np.testing.assert_allclose(camera_pose(view.camera_object()), pose, atol=0.01)
    before = [tuple(view.camera_object().location) for view in scene.fipt.capture.views]
    with pytest.raises(RuntimeError, match="edges"):
        ops.align_cameras(how="edges")  # photographs of noise
    assert [tuple(view.camera_object().location) for view in scene.fipt.capture.views] == before
