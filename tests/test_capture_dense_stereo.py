# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes by dense stereo: the whole path with a stand-in for what needs CUDA, and plain words without it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.capture.dense_stereo import read_depth_map
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import Lens
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from samples.capture_files import Sample, write_colmap
from samples.refusals import error_of
from samples.rgbd_frames import BOX_ROOM, box_room_depth, box_room_pose

SIZE, FOCAL, FRAMES = (96, 72), 60.0, 16
SCALE = 0.5  # metres per unit of the solve


def write_solve(folder: Path) -> None:
    """A COLMAP model in the middle of the box room, in units of half a meter."""
    samples = []
    for index in range(FRAMES):
        pose = box_room_pose(index, FRAMES)
        pose[:3, 3] /= SCALE
        lens = Lens("SIMPLE_RADIAL", (FOCAL, SIZE[0] / 2, SIZE[1] / 2, 0.01))
        samples.append(Sample(f"{index:03d}", *SIZE, lens, pose))
    write_colmap(folder, samples, text=False)


def depth_maps(workspace: Path) -> None:
    """What dense stereo finds in the box room, in the units of the solve."""
    model = pycolmap.Reconstruction(str(workspace / "sparse"))
    folder = workspace / "stereo" / "depth_maps"
    for image in model.images.values():
        assert (workspace / "images" / image.name).is_file() and image.name == Path(image.name).name
        camera, pose = model.cameras[image.camera_id], np.eye(4)
        pose[:3] = image.cam_from_world().inverse().matrix()
        pose[:3, 3] *= SCALE
        fx, _, cx, cy = camera.params
        depth = box_room_depth(pose, (camera.width, camera.height), fx, (cx, cy)) / SCALE
        depth[:3] = 0.0
        data = f"{camera.width}&{camera.height}&1&".encode() + depth.astype("<f4").tobytes()
        (folder / f"{image.name}.geometric.bin").write_bytes(data)


def options(**changes: object) -> CaptureOptions:
    return CaptureOptions(hold_back=0, dense_stereo=True, up_axis="z", scale=SCALE, voxel=0.05, **changes)


def test_photographs_become_a_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_solve(tmp_path / "solve")
    run, runs = RunFolder(tmp_path / "run"), []
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(
        pycolmap, "patch_match_stereo", lambda path: (runs.append(path), depth_maps(Path(path)))
    )
    ingest(tmp_path / "solve", run, options(), Reporter(io.StringIO()))
    mesh = Path(read_json(run.capture_json)["mesh"])
    vertices, triangles = read_mesh(mesh)
    assert mesh == run.fused_ply and len(triangles) > 2000
    low, high = BOX_ROOM[0]
    metres = SCALE * vertices
    assert (metres > np.array(low) - 0.05).all() and (metres < np.array(high) + 0.05).all()
    walls = np.minimum(np.abs(metres - low), np.abs(metres - high)).min(axis=1)
    assert np.mean(walls < 0.01) > 0.4  # most of what the cameras see is walls and floor
    assert not runs[0].exists()  # what stereo needed is deleted
    ingest(tmp_path / "solve", run, options(), Reporter(io.StringIO()))
    assert len(runs) == 1  # the mesh of the same photographs is kept


def test_failures_of_stereo_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_solve(tmp_path / "solve")
    run = RunFolder(tmp_path / "run")
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(pycolmap, "patch_match_stereo", lambda path: None)  # writes no depth maps
    caught = error_of(ingest, tmp_path / "solve", run, options(), Reporter(io.StringIO()))
    assert caught.code == "stereo-failed" and not run.capture_json.exists()


def test_without_cuda_it_is_refused_or_a_room_of_planes_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_solve(tmp_path / "solve")
    run = RunFolder(tmp_path / "run")
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    with pytest.raises(FiptError, match="CUDA") as caught:
        ingest(tmp_path / "solve", run, options(), Reporter(io.StringIO()))
    assert caught.value.code == "stereo-cuda" and "--plane-room" in caught.value.remedy
    caught = error_of(ingest, tmp_path / "solve", run, options(plane_room=True), Reporter(io.StringIO()))
    assert caught.code == "room-points" and not run.root.exists()


@pytest.mark.parametrize("data", [b"", b"4&4&1", b"4&4&3&" + bytes(192), b"4&4&1&" + bytes(60), b"-4&4&1&"])
def test_damaged_depth_maps_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.bin"):
        read_depth_map(tmp_path / "a.bin")


def test_unknown_depths_are_zero(tmp_path: Path) -> None:
    values = np.array([[1.5, np.nan, -1.0], [0.0, np.inf, 2.5]], "<f4")
    (tmp_path / "a.bin").write_bytes(b"3&2&1&" + values.tobytes())
    np.testing.assert_array_equal(read_depth_map(tmp_path / "a.bin"), [[1.5, 0, 0], [0, 0, 2.5]])
