# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures come to a mesh by what their depth images measure, or by the points of many photographs."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fipt_blender.core.capture import align_mesh
from fipt_blender.core.capture.depth_points import depth_points
from fipt_blender.core.capture.formats.registry import colmap, read_points, read_rig
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from samples import metashape_writers, rig_writers
from samples.rgbd_frames import BOX_ROOM, write_box_room

SIZE, FOCAL, FRAMES = (64, 48), 40.0, 6
INCHES = 1.0 / 0.0254


def moved_mesh(path: Path, matrix: np.ndarray) -> None:
    """The room as a laser would have it: in other coordinates and in inches."""
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    lines, start = [], 1
    for low, high in BOX_ROOM:
        corners = [[(low, high)[bit][axis] for axis, bit in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
        moved = np.array(corners) @ matrix[:3, :3].T + matrix[:3, 3]
        lines += ["v {:.9g} {:.9g} {:.9g}".format(*corner) for corner in moved]
        lines += ["f " + " ".join(str(start + index) for index in quad) for quad in quads]
        start += 8
    path.write_text("\n".join(lines) + "\n")


def test_cameras_come_to_a_laser_mesh_by_their_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(align_mesh, "MOST_POINTS", 300)  # for speed
    poses = write_box_room(tmp_path / "room", FRAMES, SIZE, FOCAL)
    turn = np.array([[0.36, -0.8, 0.48], [0.48, 0.6, 0.64], [-0.8, 0.0, 0.6]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = INCHES * turn, (30.0, -100.0, 7.0)
    moved_mesh(tmp_path / "laser.obj", matrix)
    options = CaptureOptions(hold_back=0, mesh=tmp_path / "laser.obj", align_mesh=True, up_axis="z", scale=0.0254)
    ingest(tmp_path / "room", RunFolder(tmp_path / "run"), options, Reporter(io.StringIO()))
    data = json.loads((tmp_path / "run" / "capture.json").read_text())
    assert data["mesh"] == str(tmp_path / "laser.obj")
    for view, pose in zip(data["views"], poses, strict=True):
        truth = 0.0254 * (matrix @ pose)[:3, 3]
        np.testing.assert_allclose(np.array(view["camera_to_world"])[:3, 3], truth, atol=5e-3)
        np.testing.assert_allclose(np.array(view["camera_to_world"])[:3, :3], turn @ pose[:3, :3], atol=np.radians(0.2))


def test_pixels_beside_edges_are_no_points(tmp_path: Path) -> None:
    write_box_room(tmp_path / "room", 1, SIZE, FOCAL)
    path = tmp_path / "room" / "frame-000000.depth.png"
    depth = np.full((SIZE[1], SIZE[0]), 2000, np.uint16)
    depth[:, 32:] = 3000
    depth[:, 31] = 2500  # between both sides, as depth cameras measure at edges
    depth[10] = 0
    Image.fromarray(depth).save(path)
    rig = read_rig(tmp_path / "room", "auto", CaptureOptions())
    points = depth_points(rig.depths, np.random.default_rng(0))
    pose = rig.depths[0].camera_to_world
    depths = (points - pose[:3, 3]) @ pose[:3, 2]
    assert len(points) == 200 and set(np.round(depths, 6)) == {2.0, 3.0}
    Image.fromarray(np.full((SIZE[1], SIZE[0]), [1000, 2000] * 32, np.uint16)).save(path)
    with pytest.raises(FiptError, match="edges") as caught:
        depth_points(rig.depths, np.random.default_rng(0))
    assert caught.value.code == "depth-empty"


def test_points_that_many_photographs_show_are_the_sure_ones(tmp_path: Path) -> None:
    shots = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), colmap.SURE_VIEWS)
    metashape_writers.write_realityscan_colmap(tmp_path / "colmap", shots)
    folder = next(tmp_path.glob("colmap/**/cameras.*")).parent
    model = pycolmap.Reconstruction(str(folder))
    images = sorted(model.reg_image_ids())
    for image in images:
        model.images[image].points2D = pycolmap.Point2DList(
            [pycolmap.Point2D(np.ones(2)) for _ in range(colmap.ENOUGH_POINTS + 20)]
        )
    for index in range(colmap.ENOUGH_POINTS + 20):
        sure = index < colmap.ENOUGH_POINTS
        elements = [pycolmap.TrackElement(image, index) for image in images[: None if sure else 2]]
        model.add_point3D(np.array([float(sure), 0.0, index]), pycolmap.Track(elements), np.zeros(3, np.uint8))
    written = tmp_path / "written"
    written.mkdir()
    model.write(str(written))
    every, sure = read_points(written, "colmap"), read_points(written, "colmap", sure=True)
    assert len(sure) == colmap.ENOUGH_POINTS < len(every)
    assert (sure[:, 0] == 1.0).all()
