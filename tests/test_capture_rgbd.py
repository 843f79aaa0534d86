"""Folders of RGB-D frames: cameras, the mesh that is fused, and every fault in words."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.depth_images import fuse, pixel_spacing, read_depth
from fipt_blender.core.capture.formats.registry import detect_format, read_rig
from fipt_blender.core.capture.mesh_file import read_mesh
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.runfolder import RunFolder
from samples import rgbd_frames
from samples.ingesting import edited_json, run_ingest
from samples.refusals import error_of
from samples.rgbd_frames import WALL, frame_pose

WIDTH, HEIGHT, FOCAL = 64, 48, 48.0
FRAMES = 4


def write_frames(folder: Path) -> Path:
    return rgbd_frames.write_frames(folder, FRAMES, (WIDTH, HEIGHT), FOCAL)


def import_frames(capture: Path, run: Path, **options: object) -> dict:
    """The capture.json."""
    run_ingest(capture, RunFolder(run), **{"hold_back": 0, **options})
    return json.loads((run / "capture.json").read_text())


def write_matrix(path: Path, matrix: np.ndarray) -> None:
    np.savetxt(path, matrix, "%.9f")


def test_frames_of_one_folder_are_read_with_intrinsics_of_each_size(tmp_path: Path) -> None:
    write_frames(tmp_path / "room" / "data")
    assert detect_format(tmp_path / "room") == "rgbd"
    rig = read_rig(tmp_path / "room", "auto", CaptureOptions())
    assert len(rig.views) == len(rig.depths) == FRAMES and rig.mesh is None and not rig.notes
    view, depth = rig.views[1], rig.depths[1]
    assert (view.width, view.height) == (2 * WIDTH, 2 * HEIGHT)
    assert view.lens.parameters == pytest.approx((2 * FOCAL, 2 * FOCAL, WIDTH, HEIGHT))
    assert (depth.fx, depth.fy, depth.cx, depth.cy) == (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    assert np.allclose(view.camera_to_world, frame_pose(1)) and np.allclose(depth.camera_to_world, frame_pose(1))


def test_frames_of_scannets_exporter_are_read_in_order_with_both_cameras(tmp_path: Path) -> None:
    rig = read_rig(rgbd_frames.write_exported_scan(tmp_path / "scan", (WIDTH, HEIGHT), FOCAL), "auto", CaptureOptions())
    assert [view.name for view in rig.views] == ["9", "10"]
    assert rig.views[0].lens.parameters == (2.5 * FOCAL, 2.5 * FOCAL, 30.0, 20.0)
    assert (rig.depths[0].fx, rig.depths[0].cx, rig.depths[0].cy) == (FOCAL, 30.0, 20.0)


def test_zero_and_the_highest_code_are_no_measurements(tmp_path: Path) -> None:
    rig = read_rig(write_frames(tmp_path / "room"), "auto", CaptureOptions())
    image = read_depth(rig.depths[0], 1.0)
    assert not image.depth[:8].any() and np.allclose(image.depth[8:], WALL)
    assert image.color is not None and image.color.shape == (HEIGHT, WIDTH, 3)


def test_frames_without_photographs_add_their_depth_and_lost_poses_are_told(tmp_path: Path) -> None:
    folder = write_frames(tmp_path / "room")
    (folder / "frame-000001.color.png").unlink()
    write_matrix(folder / "frame-000002.pose.txt", np.full((4, 4), -np.inf))
    rig = read_rig(folder, "auto", CaptureOptions())
    assert len(rig.views) == 2 and len(rig.depths) == 3
    assert [note.code for note in rig.notes] == ["pose-lost"] and "1 of 4" in rig.notes[0].text


def test_ingest_fuses_the_mesh_once(tmp_path: Path) -> None:
    capture, run = write_frames(tmp_path / "room"), tmp_path / "run"
    data = import_frames(capture, run)
    assert data["mesh"] == str(run / "fused.ply")
    vertices, triangles = read_mesh(run / "fused.ply")
    assert np.abs(vertices[:, 2] - WALL).max() < 1e-3 and len(triangles) > 500
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (facing < 0.0).all()  # towards the cameras
    made = (run / "fused.ply").stat().st_mtime_ns
    import_frames(capture, run)
    assert (run / "fused.ply").stat().st_mtime_ns == made
    import_frames(capture, run, voxel=0.02)  # otherwise twice the pixels' distance, 6 cm
    assert len(read_mesh(run / "fused.ply")[1]) > 6 * len(triangles)


def test_voxels_follow_the_pixels_and_confidence_maps_weigh(tmp_path: Path) -> None:
    folder = rgbd_frames.write_exported_scan(tmp_path / "scan", (WIDTH, HEIGHT), FOCAL)
    views = read_rig(folder, "auto", CaptureOptions()).depths
    assert pixel_spacing([read_depth(view, 1.0) for view in views]) == pytest.approx(WALL / FOCAL, rel=1e-3)
    assert (read_depth(views[0], 1.0).weight == 1.0).all()  # as near as that, noise does not grow
    (folder / "confidence").mkdir()
    Image.fromarray(np.full((HEIGHT, WIDTH), 1, np.uint8)).save(folder / "confidence" / views[0].path.name)
    Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8)).save(folder / "confidence" / views[1].path.name)
    assert (read_depth(views[0], 1.0).weight == 0.5).all()
    assert (read_depth(views[1], 1.0).weight == np.float32(0.05)).all()


def write_stray_scanner(folder: Path, pictures: Sequence[str]) -> None:
    for name in ("depth", "rgb"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "camera_matrix.csv").write_text(f"{2 * FOCAL}, 0.0, {WIDTH}\n0.0, {2 * FOCAL}, {HEIGHT}\n0.0, 0.0, 1.0\n")
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for index in range(FRAMES):
        rows.append(f"{index / 60:.6f}, {index:06d}, {0.1 * index}, 0, 0, 0, 0, 0, 1")
        rgbd_frames.write_depth(folder / "depth" / f"{index:06d}.png", (WIDTH, HEIGHT))
    for name in pictures:
        rgbd_frames.write_color(folder / "rgb" / f"{name}.jpg", (2 * WIDTH, 2 * HEIGHT))
    (folder / "odometry.csv").write_text("\n".join(rows))


def test_stray_scanner_gives_all_depth_images_with_poses(tmp_path: Path) -> None:
    write_stray_scanner(tmp_path, ["000000", "000002"])
    rig = read_rig(tmp_path, "auto", CaptureOptions())
    assert rig.source == "stray-scanner" and len(rig.views) == 2 and len(rig.depths) == FRAMES
    assert rig.depths[3].photograph is None and rig.depths[2].photograph is rig.views[1]
    np.testing.assert_allclose(rig.depths[3].camera_to_world, frame_pose(3))
    assert (rig.depths[3].fx, rig.depths[3].cx) == (FOCAL, WIDTH / 2)
    for file in (tmp_path / "rgb").iterdir():
        file.unlink()
    error = error_of(read_rig, tmp_path, "auto", CaptureOptions())
    assert error.code == "image-missing" and "ffmpeg" in error.remedy


@pytest.mark.parametrize(
    ("pictures", "frames"),
    [
        (["000001", "000002", "000003", "000004"], [0, 1, 2, 3]),  # as ffmpeg numbers them by itself
        (["0", "1", "2", "3"], [0, 1, 2, 3]),
        (["0.000", "0.0334"], [0, 2]),  # by their times
        (["000000", "000001", "000002"], None),  # which of four frames was dropped?
        (["000001", "000002"], None),
        (["000000", "000001", "000002", "000003", "000004"], None),
    ],
)
def test_pictures_of_a_video_belong_to_their_frames_or_are_refused(
    tmp_path: Path, pictures: list[str], frames: list[int] | None
) -> None:
    write_stray_scanner(tmp_path, pictures)
    if frames is None:
        error = error_of(read_rig, tmp_path, "auto", CaptureOptions())
        assert error.code == "pairs-unsure" and str(len(pictures)) in error.text and "ffmpeg" in error.remedy
    else:
        views = read_rig(tmp_path, "auto", CaptureOptions()).views
        assert [view.image.stem for view in views] == pictures
        assert [round(10.0 * view.camera_to_world[0, 3]) for view in views] == frames


def test_depth_images_are_matched_by_the_value_of_their_number_and_the_rest_is_counted(tmp_path: Path) -> None:
    folder = rgbd_frames.write_exported_scan(tmp_path / "scan", (WIDTH, HEIGHT), FOCAL)
    for file in list((folder / "depth").iterdir()):
        file.rename(file.with_name(f"{int(file.stem):06d}.png"))
    rig = read_rig(folder, "auto", CaptureOptions())
    assert [depth.path.name for depth in rig.depths] == ["000009.png", "000010.png"] and not rig.notes
    (folder / "depth" / "000010.png").rename(folder / "depth" / "000011.png")
    told = {note.code: note.text for note in read_rig(folder, "auto", CaptureOptions()).notes}
    assert "1 depth images" in told["depths-unpaired"] and "1 frames" in told["depths-unpaired"]
    (folder / "depth" / "000009.png").unlink()
    assert error_of(read_rig, folder, "auto", CaptureOptions()).code == "depth-empty"


@pytest.mark.parametrize(
    ("field", "unit"), [("depth_file_path", "depth_unit_scale_factor"), ("depth_path", "integer_depth_scale")]
)
def test_depth_images_of_transforms_are_fused(tmp_path: Path, field: str, unit: str) -> None:
    folder, frames = tmp_path / "in", []
    folder.mkdir()
    for index in range(FRAMES):
        rgbd_frames.write_color(folder / f"{index}.png", (WIDTH, HEIGHT))
        rgbd_frames.write_depth(folder / f"{index}.depth.png", (WIDTH, HEIGHT), 0.5 * WALL)
        pose = (frame_pose(index) @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
        frames.append({"file_path": f"{index}.png", field: f"{index}.depth.png", "transform_matrix": pose})
    lens = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL}
    (folder / "transforms.json").write_text(json.dumps({**lens, unit: 0.002, "frames": frames}))
    data = import_frames(folder, tmp_path / "run")
    vertices, _ = read_mesh(Path(data["mesh"]))
    assert np.abs(vertices[:, 2] - WALL).max() < 1e-3
    np.save(folder / "0.npy", np.ones((HEIGHT, WIDTH)))  # nerfstudio reads arrays, too
    with edited_json(folder / "transforms.json") as stored:
        stored["frames"][0][field] = "0.npy"
    assert error_of(import_frames, folder, tmp_path / "other").code == "depth-format"


def test_the_fused_mesh_keeps_to_its_budget(tmp_path: Path) -> None:
    capture, run = write_frames(tmp_path / "room"), tmp_path / "run"
    import_frames(capture, run, triangles=200, voxel=0.02)
    vertices, triangles = read_mesh(run / "fused.ply")
    assert 100 <= len(triangles) <= 200 and np.abs(vertices[:, 2] - WALL).max() < 5e-3
    for impossible in ({"triangles": 5}, *({"voxel": voxel} for voxel in (1e-4, -1.0, 5.0, float("nan")))):
        error = error_of(import_frames, capture, tmp_path / "other", **impossible)
        assert error.code == "setting-invalid" and not (tmp_path / "other").exists()


def test_a_given_mesh_is_simplified_in_a_copy(tmp_path: Path) -> None:
    capture, run = write_frames(tmp_path / "room"), tmp_path / "run"
    side, far = 41, np.array([3000.0, -2000.0, 100.0])
    steps = np.arange(side)
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    first = np.add.outer(side * steps[:-1], steps[:-1]).ravel()
    corners = (first[:, None] + [0, 1, side + 1, 0, side + 1, side]).reshape(-1, 3)
    vertices = 0.1 * np.stack([x, y, 0 * x], axis=1) + far
    # Every triangle with vertices of its own, as STL and some exporters write them.
    loose = "".join("v {:.9g} {:.9g} {:.9g}\n".format(*vertex) for vertex in vertices[corners].reshape(-1, 3))
    faces = "".join(f"f {i + 1} {i + 2} {i + 3}\n" for i in range(0, 3 * len(corners), 3))
    (tmp_path / "plane.obj").write_text(loose + faces)
    data = import_frames(capture, run, mesh=tmp_path / "plane.obj", triangles=300)
    assert data["mesh"] == str(run / "simplified.ply")
    small, triangles = read_mesh(run / "simplified.ply")
    assert 100 <= len(triangles) <= 300
    np.testing.assert_allclose([small.min(axis=0), small.max(axis=0)], [far, far + [4, 4, 0]], atol=2e-3)
    data = import_frames(capture, tmp_path / "all", mesh=tmp_path / "plane.obj", triangles=len(corners))
    assert data["mesh"] == str(tmp_path / "plane.obj")


def test_a_mesh_beside_the_frames_is_used(tmp_path: Path) -> None:
    capture = write_frames(tmp_path / "room")
    (capture / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    data = import_frames(capture, tmp_path / "run")
    assert data["mesh"] == str(capture / "mesh.obj") and not (tmp_path / "run" / "fused.ply").exists()


def test_some_of_the_photographs_are_used_with_all_depth_images(tmp_path: Path) -> None:
    capture = write_frames(tmp_path / "room")
    data = import_frames(capture, tmp_path / "run", views=2)
    assert [view["name"] for view in data["views"]] == ["frame-000000", "frame-000002"]
    width = np.ptp(read_mesh(tmp_path / "run" / "fused.ply")[0][:, 0])
    assert width > WALL * WIDTH / FOCAL  # what two of all images see; the two with photographs see less


def test_poses_far_away_are_left_out_instead_of_wrapping_around(tmp_path: Path) -> None:
    capture = write_frames(tmp_path / "room")
    far = frame_pose(3)
    far[:3, 3] = 9e7
    write_matrix(capture / "frame-000003.pose.txt", far)
    import_frames(capture, tmp_path / "run")
    assert np.abs(read_mesh(tmp_path / "run" / "fused.ply")[0]).max() < 10.0


def test_captures_in_other_units_get_voxels_in_metres(tmp_path: Path) -> None:
    rig = read_rig(write_frames(tmp_path / "room"), "auto", CaptureOptions())
    assert np.abs(fuse(rig.depths[:2], CaptureOptions(), 0.1, lambda share: None).vertices[:, 2]).mean() == (
        pytest.approx(10.0 * WALL, rel=1e-3)
    )


def write_depth(path: Path, value: int, kind: type = np.uint16, width: int = WIDTH) -> None:
    Image.fromarray(np.full((HEIGHT, width), value, kind)).save(path)


def everywhere(folder: Path, value: int) -> None:
    for path in folder.glob("*.depth.png"):
        write_depth(path, value)


def in_units_of_replica(folder: Path) -> None:
    rgbd_frames.write_box_room(folder, 8, (WIDTH, HEIGHT), FOCAL / 2)
    for path in folder.glob("*.depth.png"):
        Image.fromarray((6.5535 * np.asarray(Image.open(path))).astype(np.uint16)).save(path)


SHEAR = np.eye(4) + 0.5 * np.eye(4, k=1)[[0, 3, 3, 3]]
FAULTS = {
    "cut off": ("depth-unreadable", lambda p: os.truncate(p / "frame-000000.depth.png", 40)),
    "eight bits": ("depth-format", lambda p: write_depth(p / "frame-000000.depth.png", 90, np.uint8)),
    "size": ("depth-size", lambda p: write_depth(p / "frame-000003.depth.png", 2000, width=WIDTH // 2)),
    "unit": ("depth-unit", lambda p: everywhere(p, 20)),
    "other unit": ("depth-unit", in_units_of_replica),
    "empty": ("depth-empty", lambda p: everywhere(p, 0)),
    "no lens": ("intrinsics-missing", lambda p: (p / "camera-intrinsics.txt").unlink()),
    "sheared": ("pose-not-rotation", lambda p: write_matrix(p / "frame-000001.pose.txt", frame_pose(1) @ SHEAR)),
    "focal": ("intrinsics-invalid", lambda p: write_matrix(p / "camera-intrinsics.txt", np.diag([0.0, FOCAL, 1.0]))),
    "words": ("rig-damaged", lambda p: (p / "frame-000001.pose.txt").write_text("1 0 0 0\nlost\n")),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_said_and_nothing_is_written(tmp_path: Path, fault: str) -> None:
    capture, (code, damage) = write_frames(tmp_path / "room"), FAULTS[fault]
    damage(capture)
    assert error_of(import_frames, capture, tmp_path / "run").code == code
    assert not (tmp_path / "run").exists()
