# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Alignments use the points of many photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from fipt_blender.core.capture.formats.registry import colmap, read_points
from samples import metashape_writers, rig_writers


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
        model.add_point3D(
            np.array([float(sure), 0.0, index]), pycolmap.Track(elements), np.zeros(3, np.uint8)
        )
    written = tmp_path / "written"
    written.mkdir()
    model.write(str(written))
    every, sure = read_points(written, "colmap"), read_points(written, "colmap", sure=True)
    assert len(sure) == colmap.ENOUGH_POINTS < len(every)
    assert (sure[:, 0] == 1.0).all()
