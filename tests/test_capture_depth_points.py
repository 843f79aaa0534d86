# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points by which cameras are refined: what depth images measure, or those of many photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fipt_blender.core.capture.formats.registry import colmap, read_points, read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.checks.align import depth_points
from fipt_blender.core.run.errors import FiptError
from samples import metashape_writers, rig_writers
from samples.rgbd_frames import write_box_room

SIZE, FOCAL, FRAMES = (64, 48), 40.0, 6


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
