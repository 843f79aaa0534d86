# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures without a mesh get a room from their points; alignments use the points of many photographs."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.capture import colmap
from fipt_blender.core.capture.formats import read_points
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from samples import metashape_writers, rig_writers

SIZE = np.array([5.0, 4.0, 2.5])


def write_solve(folder: Path, points: np.ndarray) -> None:
    """An OpenSfM reconstruction in a box from the origin to SIZE."""
    shots = []
    for index, shot in enumerate(rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), 3)):
        angle = 2.0 * index
        level = np.array([[np.cos(angle), np.sin(angle), 0], [0, 0, -1], [-np.sin(angle), np.cos(angle), 0]])
        shots.append(
            replace(shot, width=24, height=16, rotation=level, centre=np.array([1.5 + index, 2.0, 1.5]))
        )
    rig_writers.write_opensfm(folder, [shots], "perspective", points)
    for shot in shots:
        pixels = 2.0 + np.random.default_rng(0).random((16, 24, 3), np.float32)
        write_exr((folder / "images" / shot.name).with_suffix(".exr"), pixels)


def box_points(count: int) -> np.ndarray:
    """Points on the faces of the box."""
    rng = np.random.default_rng(5)
    points = rng.random((count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = rng.integers(0, 2, count)
    return points * SIZE


def test_a_capture_without_a_mesh_gets_a_room(tmp_path: Path) -> None:
    write_solve(tmp_path / "solve", box_points(900))
    run, stream = RunFolder(tmp_path / "run"), io.StringIO()
    ingest(tmp_path / "solve", run, CaptureOptions(plane_room=True, hold_back=0), Reporter(stream))
    mesh = Path(read_json(run.capture_json)["mesh"])
    assert mesh == run.planes_obj
    vertices, triangles = read_mesh(mesh)
    np.testing.assert_allclose(vertices.min(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(vertices.max(axis=0), SIZE, atol=0.03)
    corners = vertices[triangles]
    volume = -np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(SIZE.prod(), rel=0.02)
    names = [line[2:] for line in mesh.read_text().splitlines() if line.startswith("o ")]
    assert names == ["Floor", "Ceiling", *(f"Wall.{number:03d}" for number in range(1, 5))]
    messages = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert "plane-room" in {message.get("code") for message in messages}


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
