# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `align`: cameras come back to a mesh by the points of their solve, and by edges; refusals."""

from __future__ import annotations

import io
import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.alignment.edges import EdgeFit
from fipt_blender.core.alignment.polish import polish
from fipt_blender.core.alignment.turns import cross_matrix, turn_by
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.checks import align
from fipt_blender.core.conventions import split_similarity, transform_points, transform_poses
from fipt_blender.core.run.contents import Placements
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.surface.room import Room
from samples import rig_writers
from samples.camera_poses import look_at
from samples.refusals import error_of
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


def run_align(folder: Path, how: str, capture: Path | None) -> tuple[Placements, list[dict]]:
    stream = io.StringIO()
    arguments = Namespace(folder=folder, how=how, capture=capture, format="auto", device="llvm")
    align.run(arguments, Reporter(stream))
    messages = [json.loads(line) for line in stream.getvalue().splitlines()]
    return read_document(folder / "align.json", Placements), messages


def level_poses() -> dict[str, np.ndarray]:
    places = [
        ([1.0, -1.0, 1.6], [-1.0, 1.0, 1.0]),
        ([-1.0, -1.0, 1.5], [1.0, 1.0, 1.0]),
        ([1.5, 0.0, 1.4], [-1.0, 0.2, 1.0]),
    ]
    return {f"view{index}": look_at(*place) for index, place in enumerate(places)}


@pytest.mark.parametrize("how", ["points", "near"])
def test_cameras_come_back_to_the_mesh(tmp_path: Path, room: Room, how: str) -> None:
    true = level_poses()
    from_world = similarity([0.3, -0.2, 2.0], 0.3, [1.0, 2.0, 3.0])
    write_solve(
        tmp_path / "solve",
        transform_points(from_world, points_of(room, 120)),
        {name: transform_poses(from_world, pose) for name, pose in true.items()},
    )
    far = similarity([0.0, 0.0, 1.9], 0.5, [4.0, 5.0, 6.0])
    near = similarity([0.0, 0.01, 0.01], 1.01, [0.02, 0.0, -0.02])
    placed = far if how == "points" else near
    write_input(tmp_path / "align", room, {n: transform_poses(placed, pose) for n, pose in true.items()})
    data, _ = run_align(tmp_path / "align", how, tmp_path / "solve")
    back = np.array(data.candidates[0].similarity) @ placed
    np.testing.assert_allclose(back, np.eye(4), atol=0.004)
    assert data.candidates[0].inliers > 0.95 and "% of the points" in data.text
    assert data.poses == {}


def test_a_mirrored_mesh_and_another_room_are_named(tmp_path: Path, room: Room) -> None:
    true = level_poses()
    points = points_of(room, 150) * [-1.0, 1.0, 1.0]
    write_solve(tmp_path / "solve", points, true)
    write_input(tmp_path / "align", room, true)
    with pytest.raises(FiptError, match="mirrored") as caught:
        run_align(tmp_path / "align", "points", tmp_path / "solve")
    assert caught.value.code == "mesh-mirrored" and "-1" in caught.value.remedy
    write_solve(tmp_path / "other", 3.0 * np.random.default_rng(0).normal(size=(110, 3)), true)
    caught = error_of(run_align, tmp_path / "align", "near", tmp_path / "other")
    assert caught.code == "alignment-failed" and "pairs" in caught.remedy
    assert not (tmp_path / "align" / "align.json").exists()


def test_captures_of_other_views_and_without_points_are_refused(tmp_path: Path, room: Room) -> None:
    write_input(tmp_path / "align", room, level_poses())
    write_solve(tmp_path / "solve", points_of(room, 99), {f"x{n}": p for n, p in level_poses().items()})
    for capture in (tmp_path / "solve", None):
        assert error_of(run_align, tmp_path / "align", "points", capture).code == "alignment-points"
    with pytest.raises(FiptError, match="edges") as caught:
        run_align(tmp_path / "align", "edges", None)  # photographs without edges
    assert caught.value.code == "alignment-edges"


def test_the_similarity_of_poses_needs_no_spread_of_directions() -> None:
    matrix = similarity([0.5, 1.0, -0.3], 2.5, [1.0, 0.0, -3.0])
    poses = np.array(list(level_poses().values()))[:2]
    found = align.similarity_of_poses(poses, transform_poses(matrix, poses))
    np.testing.assert_allclose(found, matrix, atol=1e-9)


def fit_of(pose: np.ndarray, change: np.ndarray, own: np.ndarray) -> EdgeFit:
    """The exact motion of what a camera sees if the world turns, shifts and grows about the origin."""
    turn, shift, growth = change[:3], change[3:6], change[6]
    back, centre = pose[:3, :3].T, pose[:3, 3]
    moved = back @ (cross_matrix(turn) @ centre + shift + growth * centre)
    motion = np.concatenate([back @ turn, moved]) + own
    squares = np.diag([200.0, 200.0, 50.0, 80.0, 80.0, 20.0]) ** 2
    return EdgeFit(float(np.sqrt(motion @ squares @ motion)), motion, 1e4 * squares, squares)


def test_cameras_are_polished_together_and_alone() -> None:
    rng = np.random.default_rng(0)
    poses = [look_at(list(rng.uniform(-1.5, 1.5, 3)), list(rng.uniform(-1.5, 1.5, 3))) for _ in range(12)]
    change = np.array([1e-3, -2e-3, 1e-3, 5e-3, -4e-3, 3e-3, 4e-3])
    own = np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.0])
    fits = [fit_of(pose, change, own if index == 3 else 0.0 * own) for index, pose in enumerate(poses)]
    found = polish(poses, [*fits[:-1], None])
    assert found is not None and found.alone == [3] and 0.1 < found.together < 3.0
    world = similarity(list(change[:3]), float(np.exp(change[6])), list(change[3:6]))
    assert split_similarity(world)[0] == pytest.approx(1.004, abs=1e-4)
    for index, (pose, corrected) in enumerate(zip(poses, found.poses, strict=True)):
        if index != 3:
            expected = transform_poses(np.linalg.inv(world), pose)
            np.testing.assert_allclose(corrected, expected, atol=1e-3)
    assert polish(poses[:2], fits[:2]) is None
    assert polish(poses, [fit_of(pose, 30.0 * change, 0.0 * own) for pose in poses]) is None
