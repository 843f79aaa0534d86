"""Bundle adjustment of a capture's poses: what is recovered, and what stays as it is."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.pose_refinement import RefinedPoses, refine_poses
from fipt_blender.core.capture.rig import DepthView, Lens, Rig, RigView
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder
from samples.camera_poses import look_at
from samples.ingesting import run_ingest, warnings
from samples.textured_room import FOCAL, HEIGHT, SIZE, WIDTH, photograph, wall_textures

VIEWS = 9
LENS = Lens("PINHOLE", (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2))


def true_pose(index: float) -> np.ndarray:
    """Camera to world: on an arc, turning past three walls, of which two face each other."""
    angle = 0.4 * index
    place = np.array([1.0 + 0.25 * index * np.cos(0.3), 1.0 + 0.3 * np.sin(2.0 * index), 1.2 + 0.2 * np.cos(index)])
    return look_at(place, place + [np.cos(angle), np.sin(angle), -0.1])


def disturbed(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """A pose that is turned and shifted by a motion (6,), radians and metres."""
    result = pose.copy()
    result[:3, :3] = turn_by(motion[:3]) @ pose[:3, :3]
    result[:3, 3] += motion[3:]
    return result


def depths_of(pose: np.ndarray) -> np.ndarray:
    """(HEIGHT / 2, WIDTH / 2) metres to the walls along the camera's axis."""
    y, x = np.mgrid[: HEIGHT // 2, : WIDTH // 2] + 0.5
    local = np.stack([(2 * x - WIDTH / 2) / FOCAL, (2 * y - HEIGHT / 2) / FOCAL, np.ones_like(x)], axis=-1)
    direction = local @ pose[:3, :3].T
    return (np.where(direction > 0.0, SIZE - pose[:3, 3], -pose[:3, 3]) / direction).min(axis=-1)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """Exact poses; of the depth images, every other one has a photograph."""
    folder, textures = tmp_path_factory.mktemp("room"), wall_textures(3)
    views, depths = [], []
    for step in range(2 * VIEWS - 1):
        pose, view = true_pose(0.5 * step), None
        if step % 2 == 0:
            image = folder / f"{step:02d}.png"
            Image.fromarray(np.round(255.0 * srgb_encoded(photograph(pose, textures))).astype(np.uint8)).save(image)
            view = RigView(image.stem, None, image, WIDTH, HEIGHT, LENS, pose)
            views.append(view)
        path = folder / f"{step:02d}.depth.png"
        Image.fromarray(np.round(1000.0 * depths_of(pose)).astype(np.uint16)).save(path)
        camera = (WIDTH // 2, HEIGHT // 2, FOCAL / 2, FOCAL / 2, WIDTH / 4, HEIGHT / 4, 0.001)
        depths.append(DepthView(path, *camera, pose, view))
    return Rig("rgbd", tuple(views), None, None, (), tuple(depths))


def refined(rig: Rig) -> tuple[RefinedPoses, list[dict]]:
    """What the step gives, and what it says."""
    stream = io.StringIO()
    found = refine_poses(rig, rig.views, 1.0, Reporter(stream))
    return found, [parse_message(line) for line in stream.getvalue().splitlines()]


def pixels_off(views, truth) -> float:
    """Median over views of how far points two metres away move in the photographs, pixels."""
    points = np.array([[x, y, 2.0, 1.0] for x in (-0.6, 0.0, 0.6) for y in (-0.4, 0.0, 0.4)])
    off = []
    for view, right in zip(views, truth, strict=True):
        local = points @ (np.linalg.inv(view.camera_to_world) @ right.camera_to_world).T
        off.append(FOCAL * np.linalg.norm(local[:, :2] / local[:, 2:3] - points[:, :2] / points[:, 2:3], axis=1).mean())
    return float(np.median(off))


def test_poses_of_a_scanning_app_are_recovered_and_depth_images_follow(room: Rig) -> None:
    """Errors as of a drift: those of the depth images between photographs lie between theirs."""
    motions = np.random.default_rng(1).normal(0.0, 1.0, (VIEWS, 6)) * ([0.008] * 3 + [0.015] * 3)
    motions -= motions.mean(axis=0)
    between = np.stack([np.interp(np.arange(2 * VIEWS - 1), 2 * np.arange(VIEWS), each) for each in motions.T], axis=1)
    depths = [
        replace(d, camera_to_world=disturbed(d.camera_to_world, m)) for d, m in zip(room.depths, between, strict=True)
    ]
    views = tuple(
        replace(v, camera_to_world=disturbed(v.camera_to_world, m)) for v, m in zip(room.views, motions, strict=True)
    )
    found, said = refined(replace(room, views=views, depths=tuple(depths)))
    assert warnings(said) == ["poses-refined"] and found.errors is not None
    assert found.errors.before > 1.0 > 2.0 * found.errors.after
    assert pixels_off(views, room.views) > 1.5 and pixels_off(found.views, room.views) < 0.7
    assert pixels_off(found.depths, room.depths) < 0.5 * pixels_off(depths, room.depths)
    assert [view.lens for view in found.views] == [LENS] * VIEWS
    assert found.depths[2].photograph is found.views[1]


def test_exact_poses_stay_to_the_bit_and_plain_walls_are_left_alone(room: Rig, tmp_path: Path) -> None:
    found, said = refined(room)
    assert found.errors is not None and found.errors.before == found.errors.after < 0.7
    assert all(a is b for a, b in zip(found.views, room.views, strict=True)) and found.depths is room.depths
    assert not warnings(said) and "stay as they are" in said[-1]["text"]
    write_exr(tmp_path / "plain.exr", np.ones((HEIGHT, WIDTH, 3), np.float32))
    plain = tuple(replace(view, image=tmp_path / "plain.exr") for view in room.views)
    found, said = refined(replace(room, views=plain))
    assert found.errors is None and all(a is b for a, b in zip(found.views, plain, strict=True))
    assert "too few of the same features" in said[-1]["text"]


def test_photographs_of_another_lens_are_moved_to_what_depth_images_measure(room: Rig) -> None:
    """Given are the depth images' focal length, a tenth off, and their poses: 25 mm beside, at another moment."""
    motions = np.random.default_rng(2).normal(0.0, 1.0, (VIEWS, 6)) * ([0.006] * 3 + [0.01] * 3)
    lens = Lens("PINHOLE", (1.1 * FOCAL, 1.1 * FOCAL, WIDTH / 2, HEIGHT / 2))
    beside = np.eye(4)
    beside[0, 3] = -0.025
    given = [disturbed(view.camera_to_world @ beside, motion) for view, motion in zip(room.views, motions, strict=True)]
    views = tuple(replace(v, camera_to_world=pose, lens=lens) for v, pose in zip(room.views, given, strict=True))
    found, said = refined(replace(room, views=views, one_camera=True))
    assert warnings(said) == ["poses-refined"]
    assert found.views[0].lens.parameters[0] == pytest.approx(FOCAL, rel=0.01)
    assert pixels_off(found.views, room.views) < 1.0
    for before, after in zip(room.depths, found.depths, strict=True):
        assert np.array_equal(before.camera_to_world, after.camera_to_world)


def test_the_import_says_how_far_poses_were_off_and_can_keep_them(room: Rig, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    frames, motions = [], np.random.default_rng(1).normal(0.0, 0.01, (VIEWS, 6))
    for view, motion in zip(room.views, motions, strict=True):
        pose = disturbed(view.camera_to_world, motion) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": str(view.image), "transform_matrix": pose.tolist()})
    document = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "frames": frames}
    (tmp_path / "in" / "transforms.json").write_text(json.dumps(document))
    poses = []
    for keep in (False, True):
        run = RunFolder(tmp_path / f"run{keep}")
        said = run_ingest(tmp_path / "in", run, keep_poses=keep, own_paths=True, up_axis="z")
        errors = json.loads(run.ingest_json.read_text()).get("poses")
        assert ("poses-refined" in warnings(said)) is not keep
        assert errors is None if keep else errors["after"] < 0.5 * errors["before"]
        poses.append([view["camera_to_world"] for view in json.loads(run.capture_json.read_text())["views"]])
    given = [np.array(frame["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0]) for frame in frames]
    assert np.allclose(poses[1], given) and not np.allclose(poses[0], given, atol=1e-3)
