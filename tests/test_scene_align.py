"""The command `align`: cameras that are nearly right come to a mesh by the points of their solve; refusals."""

from __future__ import annotations

import io
import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.formats.registry import colmap, read_points, read_rig
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.checks import align
from fipt_blender.core.conventions import transform_points, transform_poses
from fipt_blender.core.run.contents import Placement
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.surface.room import Room
from samples import rig_writers
from samples.camera_poses import look_at
from samples.metashape_writers import write_realityscan_colmap
from samples.refusals import error_of
from samples.rgbd_frames import write_box_room
from samples.small_rooms import BOX, block, make_room, write_room


def similarity(vector: list[float], scale: float, shift: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * turn_by(np.array(vector))
    matrix[:3, 3] = shift
    return matrix


@pytest.fixture(scope="module")
def room() -> Room:
    """A box with furniture that makes all its sides different."""
    parts = [((-2.0, 0.5, 0.0), (-1.2, 2.0, 1.4)), ((0.2, 0.2, 0.0), (1.2, 0.9, 0.7))]
    parts += [((0.5, 1.4, 1.5), (1.8, 2.0, 1.7)), ((-1.0, -2.0, 0.8), (0.4, -1.5, 1.3))]
    return make_room([*BOX, *(quad for part in parts for quad in block(*part))])


def points_of(room: Room, count: int) -> np.ndarray:
    """Points spread over the mesh by area, off by 3 mm."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(room.areas), count, p=room.areas / room.areas.sum())
    return room.points_on(chosen, *rng.random((2, count))) + 0.003 * rng.normal(size=(count, 3))


def write_input(folder: Path, room: Room, poses: dict[str, np.ndarray]) -> None:
    """What Blender writes: the views as they are placed now, and the room."""
    folder.mkdir()
    write_exr(folder / "a.exr", np.ones((16, 24, 3), np.float32))
    lens = {"width": 24, "height": 16, "fx": 20.0, "fy": 20.0, "cx": 12.0, "cy": 8.0}
    views = [
        {"name": name, "split": "train", "image": "a.exr", "camera_to_world": pose.tolist(), **lens,
         "parts": None, "semantics": None}
        for name, pose in poses.items()
    ]  # fmt: skip
    head = {"format": "fipt-capture", "version": 1, "source": "opensfm", "mesh": None}
    data = {**head, "world_from_source": np.eye(4).tolist(), "views": views}
    (folder / "capture.json").write_text(json.dumps(data))
    write_room(folder, room)


def write_solve(folder: Path, points: np.ndarray, poses: dict[str, np.ndarray]) -> None:
    """A reconstruction of OpenSfM with these cameras and points."""
    (shot,) = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), 1)
    shots = [
        replace(shot, name=f"{name}.jpg", rotation=pose[:3, :3].T, centre=pose[:3, 3]) for name, pose in poses.items()
    ]
    rig_writers.write_opensfm(folder, [shots], "perspective", points)


def run_align(folder: Path, capture: Path) -> tuple[Placement, list[dict]]:
    stream = io.StringIO()
    align.run(Namespace(folder=folder, capture=capture, format="auto"), Reporter(stream))
    messages = [json.loads(line) for line in stream.getvalue().splitlines()]
    return read_document(folder / "align.json", Placement), messages


def level_poses() -> dict[str, np.ndarray]:
    places = [
        ([1.0, -1.0, 1.6], [-1.0, 1.0, 1.0]),
        ([-1.0, -1.0, 1.5], [1.0, 1.0, 1.0]),
        ([1.5, 0.0, 1.4], [-1.0, 0.2, 1.0]),
    ]
    return {f"view{index}": look_at(*place) for index, place in enumerate(places)}


def test_cameras_come_back_to_the_mesh(tmp_path: Path, room: Room) -> None:
    true = level_poses()
    from_world = similarity([0.3, -0.2, 2.0], 0.3, [1.0, 2.0, 3.0])
    write_solve(
        tmp_path / "solve",
        transform_points(from_world, points_of(room, 120)),
        {name: transform_poses(from_world, pose) for name, pose in true.items()},
    )
    near = similarity([0.0, 0.01, 0.01], 1.01, [0.02, 0.0, -0.02])
    write_input(tmp_path / "align", room, {n: transform_poses(near, pose) for n, pose in true.items()})
    found, messages = run_align(tmp_path / "align", tmp_path / "solve")
    np.testing.assert_allclose(np.array(found.similarity) @ near, np.eye(4), atol=0.004)
    assert "% of the points" in found.text and not [m for m in messages if m["type"] == "warning"]


def test_another_room_and_cameras_far_off_are_refused(tmp_path: Path, room: Room) -> None:
    true = level_poses()
    write_input(tmp_path / "align", room, true)
    write_solve(tmp_path / "other", 3.0 * np.random.default_rng(0).normal(size=(110, 3)), true)
    caught = error_of(run_align, tmp_path / "align", tmp_path / "other")
    assert caught.code == "alignment-failed" and "pairs" in caught.remedy
    assert not (tmp_path / "align" / "align.json").exists()
    write_solve(tmp_path / "solve", points_of(room, 120), true)
    far = similarity([0.0, 0.0, 1.9], 0.5, [4.0, 5.0, 6.0])
    write_input(tmp_path / "far", room, {n: transform_poses(far, pose) for n, pose in true.items()})
    assert error_of(run_align, tmp_path / "far", tmp_path / "solve").code == "alignment-failed"


def test_captures_of_other_views_are_refused(tmp_path: Path, room: Room) -> None:
    write_input(tmp_path / "align", room, level_poses())
    write_solve(tmp_path / "solve", points_of(room, 99), {f"x{n}": p for n, p in level_poses().items()})
    assert error_of(run_align, tmp_path / "align", tmp_path / "solve").code == "alignment-points"


def test_the_similarity_of_poses_needs_no_spread_of_directions() -> None:
    matrix = similarity([0.5, 1.0, -0.3], 2.5, [1.0, 0.0, -3.0])
    poses = np.array(list(level_poses().values()))[:2]
    found = align.similarity_of_poses(poses, transform_poses(matrix, poses))
    np.testing.assert_allclose(found, matrix, atol=1e-9)


def test_pixels_beside_edges_are_no_points(tmp_path: Path) -> None:
    write_box_room(tmp_path / "room", 1, (64, 48), 40.0)
    path = tmp_path / "room" / "frame-000000.depth.png"
    depth = np.full((48, 64), 2000, np.uint16)
    depth[:, 32:] = 3000
    depth[:, 31] = 2500  # between both sides, as depth cameras measure at edges
    depth[10] = 0
    Image.fromarray(depth).save(path)
    rig = read_rig(tmp_path / "room", "auto", CaptureOptions())
    points = align.depth_points(rig.depths, np.random.default_rng(0))
    pose = rig.depths[0].camera_to_world
    depths = (points - pose[:3, 3]) @ pose[:3, 2]
    assert len(points) == 200 and set(np.round(depths, 6)) == {2.0, 3.0}
    Image.fromarray(np.full((48, 64), [1000, 2000] * 32, np.uint16)).save(path)
    assert error_of(align.depth_points, rig.depths, np.random.default_rng(0)).code == "depth-empty"


def test_points_that_many_photographs_show_are_the_sure_ones(tmp_path: Path) -> None:
    shots = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), colmap.SURE_VIEWS)
    write_realityscan_colmap(tmp_path / "colmap", shots)
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
