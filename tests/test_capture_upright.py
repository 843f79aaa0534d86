"""Which way is up in captures: by their format, the planes of the room, or how the cameras were held."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core import conventions
from fipt_blender.core.capture.upright import doubts, find_upright
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.depth.extraction import FusedMesh
from fipt_blender.core.depth.ply import write_ply
from fipt_blender.core.run.runfolder import RunFolder
from samples.camera_poses import look_at, random_rotation
from samples.capture_files import make_samples, write_colmap, write_fipt_real, write_transforms
from samples.combinations import pairs
from samples.ingesting import run_ingest, warnings
from samples.scans import grid_triangles

SIZE = np.array([5.0, 4.0, 2.6])
AXES = {axis: conventions.world_from_source(axis)[:3, :3].T for axis in conventions.UP_AXES}


def about_z(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def sheet(corner, first, second, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A parallelogram as a grid of triangles."""
    counts = [max(1, round(float(np.linalg.norm(side)) / step)) for side in (first, second)]
    u, v = np.meshgrid(*(np.linspace(0.0, 1.0, count + 1) for count in counts), indexing="ij")
    vertices = corner + u.reshape(-1, 1) * np.array(first) + v.reshape(-1, 1) * np.array(second)
    return vertices, grid_triangles(*counts)


def box(size, step: float) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = np.diag(size)
    sides = [(0 * x, x, y), (z, y, x), (0 * x, z, x), (y, x, z), (0 * x, y, z), (x, z, y)]
    return joined([sheet(*side, step) for side in sides])


def joined(parts) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(triangles)


def furnished(rng: np.random.Generator, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A room with boxes, half of them turned away from the walls; coarse without noise."""
    step = 0.1 if noise else 10.0
    parts = [box(SIZE, step)]
    for index in range(6):
        vertices, faces = box(rng.uniform(0.3, 1.5, 3), step)
        place = rng.uniform([1.0, 1.0, 0.0], [3.0, 2.5, 0.8])
        parts.append((vertices @ about_z(index % 2 * rng.uniform(0.1, 1.4)).T + place, faces))
    vertices, triangles = joined(parts)
    return vertices + noise * rng.normal(size=vertices.shape), triangles


def held(rng: np.random.Generator, count: int, sideways: float, roll: float = 2.0) -> np.ndarray:
    """(V, 4, 4) cameras that look all around, rolled by some degrees, a share of them on their left side."""
    poses = []
    for index in range(count):
        place = rng.uniform([1.0, 1.0, 1.0], [4.0, 3.0, 1.8])
        toward = np.array([np.cos(2.4 * index), np.sin(2.4 * index), rng.normal(-0.2, 0.2)])
        pose = look_at(place, place + toward)
        turn = np.radians(roll) * rng.normal() + (0.5 * np.pi if index < sideways * count else 0.0)
        pose[:3, :3] = pose[:3, :3] @ about_z(turn)
        poses.append(pose)
    return np.array(poses)


def turned(poses: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix @ poses


def off(upright, up: np.ndarray) -> float:
    """Degrees between the direction that was found and the true one."""
    rotation = upright.world_from_source(1.0)[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.linalg.det(rotation) > 0.0
    return float(np.degrees(np.arccos(np.clip(rotation[2] @ up, -1.0, 1.0))))


@pytest.mark.parametrize(("noise", "sideways", "seed"), pairs((0.0, 0.005, 0.02), (0.0, 0.4, 1.0), range(4)))
def test_rooms_in_any_frame_stand_upright(tmp_path: Path, noise: float, sideways: float, seed: int) -> None:
    """With noise in metres."""
    rng = np.random.default_rng(seed)
    rotation, poses = random_rotation(rng), held(rng, 24, sideways)
    vertices, triangles = furnished(rng, noise)
    write_ply(tmp_path / "room.ply", FusedMesh((vertices @ rotation.T).astype(np.float32), triangles.astype(np.int32)))
    poses = turned(poses, rotation)
    found = find_upright(poses, tmp_path / "room.ply")
    assert found.source == "planes" and off(found, rotation[:, 2]) < 1.0
    # The walls become parallel to X and Y, so that other axes of the room are turns by 90 degrees away.
    wall = found.world_from_source(1.0)[:3, :3] @ rotation[:, 0]
    assert np.degrees(np.arcsin(np.sort(np.abs(wall))[1])) < 4.0
    alone = find_upright(poses, None)
    assert alone.source == "cameras" and off(alone, rotation[:, 2]) < 4.0


@pytest.mark.parametrize("axis", conventions.UP_AXES)
@pytest.mark.parametrize("with_mesh", [False, True])
def test_upright_captures_stay_as_they_are(tmp_path: Path, axis: str, with_mesh: bool) -> None:
    rng = np.random.default_rng(3)
    vertices, triangles = furnished(rng, 0.005)
    points = (vertices @ AXES[axis].T).astype(np.float32)
    write_ply(tmp_path / "room.ply", FusedMesh(points, triangles.astype(np.int32)))
    found = find_upright(turned(held(rng, 24, 0.2), AXES[axis]), tmp_path / "room.ply" if with_mesh else None)
    assert found.axis == axis and found.angle < 3.0 and found.turn is None
    np.testing.assert_array_equal(found.world_from_source(0.1), conventions.world_from_source(axis, 0.1))


def test_a_tilt_is_told_and_a_mesh_without_a_vertical_leaves_the_cameras(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    tilt = np.radians(10.3)
    rotation = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    poses = turned(held(rng, 24, 0.0), rotation)
    vertices, triangles = furnished(rng, 0.005)
    for name, points in (("room", vertices @ rotation.T), ("cloud", rng.normal(size=vertices.shape))):
        write_ply(tmp_path / f"{name}.ply", FusedMesh(points.astype(np.float32), triangles.astype(np.int32)))
    (tmp_path / "broken.ply").write_text("ply")
    for name, number in (("nan.obj", "nan"), ("far.obj", "1e200")):
        (tmp_path / name).write_text(f"v 0 0 0\nv {number} 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    found = find_upright(poses, tmp_path / "room.ply")
    assert (found.axis, found.source) == ("z", "planes") and found.angle == pytest.approx(10.3, abs=0.3)
    for name in ("nan.obj", "far.obj", "cloud.ply", "broken.ply", "flat.obj", "room.fbx"):
        found = find_upright(poses, tmp_path / name)
        assert (found.axis, found.source) == ("z", "cameras") and off(found, rotation[:, 2]) < 3.0
    wild = np.array([turned(pose, random_rotation(rng)) for pose in poses])
    assert find_upright(wild, None).turn is None  # cameras that were not held level


@pytest.mark.parametrize("stated", conventions.UP_AXES)
@pytest.mark.parametrize("true", conventions.UP_AXES)
def test_cameras_that_contradict_the_format_are_told(stated: str, true: str) -> None:
    rng = np.random.default_rng(5)
    notes = doubts(stated, turned(held(rng, 20, 0.25, roll=8.0), AXES[true]))
    assert [note.code for note in notes] == ([] if stated == true else ["up-axis-doubtful"])
    assert all(f"--up-axis={true}" in note.remedy and stated.upper() in note.text for note in notes)


def test_phones_on_either_side_do_not_contradict_the_format() -> None:
    rng = np.random.default_rng(6)
    poses = held(rng, 20, 1.0)
    for side in (0.0, np.pi):
        upside = poses.copy()
        upside[:, :3, :3] = upside[:, :3, :3] @ about_z(side)
        assert not doubts("z", upside) and doubts("x", upside)


@pytest.mark.parametrize("option", ["auto", "z"])
def test_stated_axes_are_used_to_the_bit_and_noted(tmp_path: Path, option: str) -> None:
    """A level capture of which the file says that Z is up, while Y is."""
    write_transforms(tmp_path / "in", make_samples(8, up=(0.0, 1.0, 0.0)), up_axis="z")
    run = RunFolder(tmp_path / "run")
    told = warnings(run_ingest(tmp_path / "in", run, up_axis=option))
    assert ("up-axis-doubtful" in told) == (option == "auto")
    np.testing.assert_array_equal(load_capture(run).world_from_source, np.eye(4))
    up = {"axis": "z", "source": "format" if option == "auto" else "option", "angle": 0.0}
    assert json.loads(run.ingest_json.read_text())["up"] == up
    assert "up" not in json.loads(run.capture_json.read_text())


@pytest.mark.parametrize("write", [write_fipt_real, lambda root, samples: write_colmap(root, samples, True)])
def test_formats_without_a_vertical_get_one(tmp_path: Path, write) -> None:
    rng = np.random.default_rng(7)
    rotation, samples = random_rotation(rng), make_samples(24)
    for sample in samples:
        sample.pose[:] = turned(sample.pose, rotation)
    write(tmp_path / "in", samples)
    vertices, triangles = furnished(rng, 0.0)
    lines = ["v {} {} {}".format(*corner) for corner in vertices @ rotation.T]
    lines += ["f {} {} {}".format(*face) for face in triangles + 1]
    (tmp_path / "in" / "scene.obj").write_text("\n".join(lines))
    run = RunFolder(tmp_path / "run")
    run_ingest(tmp_path / "in", run)
    capture = load_capture(run)
    assert json.loads(run.ingest_json.read_text())["up"]["source"] == "planes"
    assert (capture.world_from_source[:3, :3] @ rotation[:, 2])[2] > np.cos(np.radians(1.0))
    for view, sample in zip(capture.views, samples, strict=True):
        expected = conventions.transform_poses(capture.world_from_source, sample.pose)
        np.testing.assert_allclose(view.camera_to_world, expected, atol=1e-5)
