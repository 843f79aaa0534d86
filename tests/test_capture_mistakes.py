"""Usual mistakes of exporters are named by what explains points, mesh and photographs; right captures are not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core import conventions
from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.corrections import both, corrections, named
from fipt_blender.core.capture.mistakes import Scene, Sight, examine, small
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.runfolder import RunFolder
from samples import box_room
from samples.capture_files import write_transforms
from samples.ingesting import run_ingest, warnings
from samples.refusals import error_of

SAMPLES = box_room.make_samples()
POSES = np.array([sample.pose for sample in SAMPLES])
PHOTOGRAPHS = [small(box_room.photograph(sample.pose)) for sample in SAMPLES]
OPENGL, PYTORCH3D = np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([-1.0, -1.0, 1.0, 1.0])
MESH = (box_room.CORNERS, box_room.TRIANGLES)


def scene(poses=POSES, mesh=MESH, solved=None, photographs=PHOTOGRAPHS):
    lens = (box_room.FOCAL / box_room.WIDTH, box_room.FOCAL / box_room.HEIGHT, 0.5, 0.5)
    sights = [Sight(pose, *lens, image) for pose, image in zip(poses, photographs, strict=True)]
    found = Scene.of(sights, mesh, np.zeros((0, 3)) if solved is None else solved)
    assert found is not None
    return found


def names(poses=POSES, source="transforms", **given):
    found = examine(scene(poses, **given), source)
    return [] if found is None else [each.name for each in found.explained]


def inverse(matrices):
    return np.linalg.inv(matrices)


def transposed(matrices):
    result = matrices.copy()
    result[:, :3, :3] = np.swapaxes(matrices[:, :3, :3], 1, 2)
    return result


def with_centres(matrices):
    """World to camera, with the cameras' positions in the last column."""
    result = matrices.copy()
    result[:, :3, 3] = inverse(matrices)[:, :3, 3]
    return result


def xyzw_for_wxyz(rotation):
    """What a reader makes of a quaternion that is stored x, y, z, w, and that it takes for w, x, y, z."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    axis = axis / np.linalg.norm(axis)
    x, y, z, w = *(np.sin(angle / 2.0) * axis), np.cos(angle / 2.0)
    vector = np.array([y, z, w])  # of the quaternion x + yi + zj + wk
    length = np.linalg.norm(vector)
    return turn_by(2.0 * np.arctan2(length, x) * vector / length)


def rolled(matrices):
    result = matrices.copy()
    result[:, :3, :3] = [xyzw_for_wxyz(matrix[:3, :3]) for matrix in matrices]
    return result


@pytest.mark.parametrize(
    ("poses", "source", "name"),
    [
        (POSES, "transforms", None),
        (POSES, "colmap", None),
        (POSES @ OPENGL, "transforms", "axes-opencv"),  # OpenCV's poses as they are, read as OpenGL's
        (POSES @ OPENGL, "colmap", "axes-opengl"),
        (POSES @ PYTORCH3D @ OPENGL, "transforms", "axes-pytorch3d"),
        (inverse(POSES @ OPENGL) @ OPENGL, "transforms", "inverse"),
        (inverse(POSES) @ OPENGL, "transforms", "inverse+axes-opencv"),
        (inverse(POSES), "colmap", "inverse"),
        (transposed(POSES @ OPENGL) @ OPENGL, "transforms", "transpose"),
        (inverse(transposed(inverse(POSES))), "colmap", "transpose"),
        (inverse(with_centres(inverse(POSES))), "colmap", "translation"),
        (inverse(rolled(inverse(POSES))), "colmap", "quaternion"),
    ],
)
def test_a_mistake_of_the_poses_is_named_and_its_correction_undoes_it(poses, source, name):
    assert names(poses, source) == ([] if name is None else [name])
    if name is not None:
        known = {each.name: each for each in (*corrections(source), *both(source))}
        np.testing.assert_allclose(known[name].poses(poses), POSES, atol=1e-9)
        for each in named(source, name):
            poses = each.poses(poses)
        np.testing.assert_allclose(poses, POSES, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (np.diag([0.0254] * 3), "scale-39.3701"),
        (np.diag([1000.0] * 3), "scale-0.001"),
        (turn_by(np.array([-0.5 * np.pi, 0.0, 0.0])), "turn-x90"),
        (np.diag([-1.0, 1.0, 1.0]), "mirror-x"),
        (turn_by(np.array([-0.5 * np.pi, 0.0, 0.0])) * 100.0, "turn-x90+scale-0.01"),
    ],
)
def test_a_mistake_of_the_mesh_is_named(change, name):
    assert names(mesh=(box_room.CORNERS @ change.T, box_room.TRIANGLES)) == [name]


def test_what_does_the_same_to_a_symmetric_room_is_named_once():
    middle = 0.5 * (box_room.LOW + box_room.HIGH) * (1.0, 1.0, 0.0)
    poses = POSES.copy()
    poses[:, :3, 3] -= middle
    turned = (box_room.CORNERS - middle) @ turn_by(np.array([-0.5 * np.pi, 0.0, 0.0])).T
    assert names(poses, mesh=(turned, box_room.TRIANGLES)) == ["turn-x90"]


def test_points_of_the_solve_stand_for_a_mesh():
    rng = np.random.default_rng(0)
    points = rng.uniform(box_room.LOW, box_room.HIGH, (3000, 3))
    axis = rng.integers(0, 3, 3000)
    points[np.arange(3000), axis] = np.where(rng.random(3000) < 0.5, box_room.LOW[axis], box_room.HIGH[axis])
    assert names(source="colmap", mesh=None, solved=points) == []
    assert names(POSES @ OPENGL, "colmap", mesh=None, solved=points) == ["axes-opengl"]


def test_of_several_that_explain_all_none_is_the_cure():
    """Without photographs that tell, two units put the cameras into the room."""
    noise = [None] * len(SAMPLES)
    found = examine(scene(mesh=(100.0 * box_room.CORNERS, box_room.TRIANGLES), photographs=noise), "transforms")
    note = found.note(scene(), Path("scene.obj"))
    assert len(found.explained) > 1 and not found.is_sure and not note.fix
    assert all(each.name in note.remedy for each in found.explained)


def test_normalised_cameras_are_explained_by_nothing():
    poses = POSES.copy()
    places = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    poses[:, :3, 3] = places / np.linalg.norm(places, axis=1).max()
    found = examine(scene(poses), "transforms")
    assert not found.explained and "normalize" in found.note(scene(poses), Path("room.obj")).text


def test_what_is_named_is_refused_at_the_import_and_fixed_by_its_name(tmp_path):
    wrong = [replace(sample, pose=sample.pose @ OPENGL) for sample in SAMPLES]
    folder = tmp_path / "in"
    write_transforms(folder, wrong)
    box_room.write_photographs(folder / "images", SAMPLES)
    box_room.write_mesh(folder / "scene.obj")
    error = error_of(run_ingest, folder, RunFolder(tmp_path / "run"), hold_back=0)
    assert error.code == "convention" and error.fix == "axes-opencv" and "OpenCV" in error.text
    messages = run_ingest(folder, RunFolder(tmp_path / "run"), hold_back=0, correct=error.fix)
    assert not {"mesh-elsewhere", "up-axis-doubtful"} & set(warnings(messages))
    poses = [view.camera_to_world for view in load_capture(RunFolder(tmp_path / "run")).views]
    np.testing.assert_allclose(poses, POSES, atol=1e-9)
    run_ingest(folder, RunFolder(tmp_path / "run"), hold_back=0, correct="none")  # whoever knows better
    assert error_of(run_ingest, folder, RunFolder(tmp_path / "run"), correct="axis").code == "setting-invalid"


def test_upside_down_cameras_without_a_mesh_have_two_explanations(tmp_path):
    write_transforms(tmp_path / "in", [replace(sample, pose=sample.pose @ OPENGL) for sample in SAMPLES])
    messages = run_ingest(tmp_path / "in", RunFolder(tmp_path / "run"))
    told = next(message for message in messages if message.get("code") == "up-axis-doubtful")
    assert "axes-opencv" in told["remedy"] and "--up-axis=-z" in told["remedy"]


def test_fields_of_view_in_degrees_are_refused(tmp_path):
    write_transforms(tmp_path, SAMPLES[:2], camera_angle_x=77.3)
    data = json.loads((tmp_path / "transforms.json").read_text())
    for frame in data["frames"]:
        del frame["fl_x"], frame["fl_y"]
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    error = error_of(run_ingest, tmp_path, RunFolder(tmp_path / "run"))
    assert error.code == "intrinsics-invalid" and "degrees" in error.text


def test_conventions_of_cameras_are_their_own_inverse():
    for _, matrix in conventions.CAMERA_AXES.values():
        np.testing.assert_array_equal(matrix @ matrix, np.eye(4))
