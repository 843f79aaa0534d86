"""Cameras and mesh that do not belong together are told of, and far coordinates are moved to the origin."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.mesh_file import read_mesh
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.conventions import transform_points
from fipt_blender.core.run.run_files import read_capture
from fipt_blender.core.run.runfolder import RunFolder
from samples import rig_writers
from samples.capture_files import make_samples, write_colmap, write_transforms
from samples.ingesting import run_ingest, warnings
from samples.refusals import error_of

BOX = np.array([[x, y, z] for x in (-2.5, 2.5) for y in (-2.5, 2.5) for z in (-2.5, 2.5)])
QUADS = "1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"
UTM = np.array([691_000.25, 5_334_000.75, 520.5])


def write_room(path, place=None):
    points = BOX if place is None else transform_points(place, BOX)
    if path.suffix == ".ply":
        write_ply(path, points)
        return
    vertices = "".join(f"v {x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in points)
    path.write_text(vertices + "".join(f"f {quad}\n" for quad in QUADS))


def write_ply(path, points):
    """In double precision, as laser scanners' programs do."""
    kind = "ascii" if path.stem == "ascii" else "binary_little_endian"
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    header += f"element face {len(QUADS)}\nproperty list uchar int vertex_indices\nend_header\n"
    faces = [[int(index) - 1 for index in quad.split()] for quad in QUADS]
    if kind == "ascii":
        rows = [" ".join(map(repr, point)) for point in points.tolist()]
        rows += [" ".join(map(str, [4, *face])) for face in faces]
        path.write_text(header + "".join(f"{row}\n" for row in rows))
    else:
        table = np.array([(4, face) for face in faces], [("count", "u1"), ("corners", "<i4", 4)])
        path.write_bytes(header.encode() + points.astype("<f8").tobytes() + table.tobytes())


def similarity(scale=1.0, shift=(0.0, 0.0, 0.0), turn=0.0):
    place = np.eye(4)
    place[:3, :3] = scale * turn_by(np.array([turn, 0.0, 0.0]))
    place[:3, 3] = shift
    return place


def imported(tmp_path, place=None, change=lambda samples: samples, count=8):
    folder = tmp_path / "in"
    write_transforms(folder, change(make_samples(count)))
    write_room(folder / "mesh.obj", place)
    run = RunFolder(tmp_path / "run")
    return run, run_ingest(folder, run)


def note(messages, code):
    return next(message for message in messages if message.get("code") == code)


def test_a_mesh_around_the_cameras_is_right(tmp_path):
    run, messages = imported(tmp_path)
    assert not {"mesh-elsewhere", "mesh-moved", "georeferenced"} & set(warnings(messages))
    assert load_capture(run).mesh == tmp_path / "in" / "mesh.obj"


@pytest.mark.parametrize(
    ("place", "remedy"),
    [
        (similarity(shift=(30.0, 0.0, 0.0)), "Choose the cameras' own mesh"),
        (similarity(shift=(0.0, 0.0, -520.0)), "Choose the cameras' own mesh"),
        (similarity(1000.0), "scaled by 0.001"),
        (similarity(0.01), "scaled by 100"),
    ],
)
def test_a_mesh_that_is_elsewhere_is_told_with_a_remedy_that_fits(tmp_path, place, remedy):
    _, messages = imported(tmp_path, place)
    told = note(messages, "mesh-elsewhere")
    assert remedy in told["remedy"]
    assert "size-implausible" not in warnings(messages)  # whose scale would be that of the cameras, too


def test_a_mesh_with_y_up_is_told(tmp_path):
    def above_the_floor(samples):
        for sample in samples:
            sample.pose[:3, 3] += (0.0, 0.0, 5.0)
        return samples

    turned = similarity(turn=-0.5 * np.pi) @ similarity(shift=(0.0, 0.0, 5.0))
    _, messages = imported(tmp_path, turned, above_the_floor)
    assert "turned by 90 degrees about X" in note(messages, "mesh-elsewhere")["remedy"]


@pytest.mark.parametrize("written", [write_transforms, lambda root, samples: write_colmap(root, samples, True)])
@pytest.mark.parametrize("mesh", ["mesh.obj", "mesh.ply", "ascii.ply"])
def test_map_coordinates_are_moved_in_double_precision(tmp_path, written, mesh):
    samples = make_samples(6)
    near = np.array([sample.pose[:3, 3].copy() for sample in samples])
    for sample in samples:
        sample.pose[:3, 3] += UTM
    written(tmp_path / "in", samples)
    write_room(tmp_path / "in" / mesh, similarity(shift=UTM))
    run = RunFolder(tmp_path / "run")
    assert "georeferenced" in warnings(run_ingest(tmp_path / "in", run, up_axis="z"))
    capture, offset = load_capture(run), np.array(read_capture(run.capture_json).offset)
    assert (offset == np.round(offset)).all() and np.abs(offset - UTM).max() < 3.0
    places = np.array([view.camera_to_world[:3, 3] for view in capture.views])
    np.testing.assert_allclose(places + offset, near + UTM, atol=1e-5)
    vertices = transform_points(capture.world_from_source, read_mesh(capture.mesh)[0])
    found = sorted(map(tuple, np.round(vertices + offset - UTM, 4)))
    np.testing.assert_allclose(found, sorted(map(tuple, BOX)), atol=1e-4)


@pytest.mark.parametrize(
    ("place", "remedy"),
    [
        (np.eye(4), None),
        (similarity(0.3048), "scaled by 3.281"),
        (similarity(1.0, turn=-0.5 * np.pi), "turned by 90 degrees about X"),
        (similarity(shift=(3.0, 0.0, 0.0)), "(Capture > Alignment)"),  # the cameras are still within its box
    ],
)
def test_points_of_the_solve_tell_where_the_mesh_belongs(tmp_path, place, remedy):
    size = np.array([5.0, 4.0, 9.0])
    rng = np.random.default_rng(0)
    points, side = rng.uniform(-0.5, 0.5, (600, 3)), rng.choice(3, 600, p=[0.4, 0.5, 0.1])
    points[np.arange(600), side] = rng.choice([-0.5, 0.5], 600)
    shots = rig_writers.make_shots(count=4)
    rig_writers.write_opensfm(tmp_path / "in", [shots], "perspective", points * size)
    write_room(tmp_path / "in" / "mesh.obj", place @ np.diag([*(size / 5.0), 1.0]))
    messages = run_ingest(tmp_path / "in", RunFolder(tmp_path / "run"), hold_back=0)
    told = [message for message in messages if message.get("code") == "mesh-elsewhere"]
    assert not told if remedy is None else remedy in told[0]["remedy"]


def test_degrees_are_refused(tmp_path):
    def in_degrees(samples):
        for sample in samples:
            sample.pose[:3, 3] *= (1e-5, 1e-5, 1.0)
            sample.pose[:3, 3] += (11.5, 48.1, 520.0)
        return samples

    error = error_of(imported, tmp_path, None, in_degrees)
    assert error.code == "pose-unsupported" and "longitude" in error.text


def test_cameras_at_one_place_are_told(tmp_path):
    def together(samples):
        for sample in samples:
            sample.pose[:3, 3] = 0.5
        return samples

    assert "8 cameras" in note(imported(tmp_path, None, together)[1], "cameras-one-place")["text"]


@pytest.mark.parametrize("side", ["dataparser_transforms.json", "mesh_offset.xyz"])
def test_files_beside_a_moved_mesh_are_followed_where_they_fit(tmp_path, side):
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn_by(np.array([0.0, 0.0, 0.4])), (3.0, 1.0, -4.0)
    folder, run = tmp_path / "in", RunFolder(tmp_path / "run")
    write_transforms(folder, make_samples(8))
    if side.endswith("json"):
        (folder / side).write_text(json.dumps({"transform": transform[:3].tolist(), "scale": 0.45}))
        write_room(folder / "mesh.obj", np.diag([0.45, 0.45, 0.45, 1.0]) @ transform)
    else:
        (folder / side).write_text("40.0 -20.5 3\n")
        write_room(folder / "mesh.obj", similarity(shift=(-40.0, 20.5, -3.0)))
    messages = run_ingest(folder, run)
    assert "mesh-moved" in warnings(messages) and "mesh-elsewhere" not in warnings(messages)
    np.testing.assert_allclose(read_mesh(load_capture(run).mesh)[0], BOX, atol=1e-5)
    write_room(folder / "mesh.obj")  # which needs no such file
    assert "mesh-moved" not in warnings(run_ingest(folder, run))


def test_the_unit_of_a_projection_is_told(tmp_path):
    (tmp_path / "in").mkdir()
    text = 'PROJCS["x",GEOGCS["WGS 84",UNIT["degree",0.0174532925]],UNIT["US survey foot",0.3048006096]]'
    (tmp_path / "in" / "room.prj").write_text(text)
    assert "0.3048006096" in note(imported(tmp_path)[1], "mesh-unit")["remedy"]
