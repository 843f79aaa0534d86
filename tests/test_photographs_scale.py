"""Scale and up axis of solved cameras: analytic cases, texts of the user, printed markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import tone_mapped
from fipt_blender.core.capture.upright import common_up
from fipt_blender.prepare import scale
from fipt_blender.prepare.preparation import PreparationFolder
from fipt_blender.prepare.scale import Pick, marker_finder
from fipt_blender.prepare.solve_step import poses, read_model, write_model
from fipt_blender.prepare.solving import copy_name
from samples.camera_poses import look_at, random_rotation
from samples.prepared_captures import facts, placed_model, run_with, single
from samples.refusals import error_of
from samples.textured_room import HEIGHT, WIDTH, photograph


def turned(pose: np.ndarray, quarter_turns: int) -> np.ndarray:
    """A camera that is rolled about its axis of view."""
    angle = 0.5 * np.pi * quarter_turns
    roll = np.eye(4)
    roll[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return pose @ roll


@pytest.mark.parametrize("around", [True, False], ids=["all directions", "one direction"])
@pytest.mark.parametrize("sideways", [0, 2])
def test_up_of_level_cameras_in_any_frame(around: bool, sideways: int) -> None:
    generator = np.random.default_rng(5)
    poses = []
    for index in range(9):
        position = generator.uniform(-1.0, 1.0, 3)
        toward = [np.cos(index), np.sin(index), -0.5] if around else [1.0, 0.0, -0.5 + 0.1 * index]
        pose = look_at(position, position + np.array(toward))
        poses.append(turned(pose, 1) if index < sideways else pose)
    frame = np.eye(4)
    frame[:3, :3] = random_rotation(generator)
    up = common_up(frame @ np.array(poses)).up
    # Along one line, only the mean of the tilts tells up from forward.
    assert np.degrees(np.arccos(min(1.0, up @ frame[:3, 2]))) < (0.5 if around else 8.0)


def test_the_room_frame_stands_on_the_floor_and_is_in_meters() -> None:
    generator = np.random.default_rng(2)
    places = generator.uniform([0, 0, 1], [3, 3, 2], (12, 3))
    poses = np.array([look_at(place, generator.uniform([0, 0, 0], [3, 3, 1])) for place in places])
    points = generator.uniform([0, 0, 0], [3, 3, 2.5], (2000, 3))
    other = np.eye(4)
    other[:3, :3] = random_rotation(generator)
    other[:3, 3] = [5.0, -3.0, 1.0]
    moved = other @ poses
    moved[:, :3, 3] *= 0.25  # the solve's unit is four metres
    frame = scale.room_frame(moved, 0.25 * (points @ other[:3, :3].T + other[:3, 3]), 4.0)
    result = 4.0 * frame[:3, :3] / 4.0 @ moved[:, :3, 3].T + frame[:3, 3:]
    assert np.allclose(result[2], places[:, 2], atol=0.08)
    assert np.allclose(result[:2].mean(axis=1), 0.0, atol=1e-9)
    distances = np.linalg.norm(result.T[0] - result.T[1:], axis=1)
    assert np.allclose(distances, np.linalg.norm(places[0] - places[1:], axis=1))
    assert np.allclose(scale.room_frame(moved, np.empty((0, 3)), 4.0)[:3, :3], frame[:3, :3])


def test_rays_meet_and_a_wrong_one_is_dropped() -> None:
    point = np.array([0.3, 2.0, 1.0])
    places = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1, 1], [0.5, 0, 2], [0, 0, 0.5]])
    model = placed_model([look_at(place, np.array([0.0, 2.0, 1.0])) for place in places])
    images = [model.images[number] for number in range(1, 6)]
    seen = [image.camera.img_from_cam(image.cam_from_world() * point) for image in images]
    pixels = np.array(seen).reshape(5, 2) + np.outer([0, 0, 0, 0, 1], [60.0, 30.0])  # the last sees something else
    found = scale.triangulated(images, pixels)
    assert found is not None and np.allclose(found, point, atol=1e-9)
    assert scale.triangulated([images[0]] * 2, pixels[[0, 0]]) is None, "the rays are parallel"
    assert scale.triangulated(images[:1], pixels[:1]) is None


def test_picks_and_matrices_from_a_text() -> None:
    first, second = scale.parse_picks("my desk 812 440.5, door 1 2; my desk 3 4")
    assert first == [Pick("my desk", 812.0, 440.5), Pick("door", 1.0, 2.0)] and second == [Pick("my desk", 3, 4)]
    for text in ("", "a 1 2", "a 1 2; b 3", "a 1 x; b 3 4", "a 1 2; b nan 4", "a 1 2;;", "1 2; 3 4"):
        assert error_of(scale.parse_picks, text).code == "scale-picks"
    stretched, last_row = "1 0 0 0 0 2 0 0 0 0 1 0", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2"
    for text in ("", "1 2 3", "a" * 12, stretched, "0 0 0 0 0 0 0 0 0 0 0 0", last_row):
        assert error_of(scale.parse_similarity, text).code == "scale-matrix"


def test_the_edge_of_a_marker_and_how_square_it_is() -> None:
    square = 0.3 * np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    assert scale.marker_edge(square) == pytest.approx((0.3, 0.0))
    bent = square + [[0.1, 0.1, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert scale.marker_edge(bent)[1] > 0.1


def test_a_printed_marker_is_found_to_a_tenth_of_a_pixel() -> None:
    cv2 = pytest.importorskip("cv2")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker = cv2.aruco.generateImageMarker(dictionary, 7, 480)
    picture = np.full((900, 1200), 230, np.uint8)
    picture[200:680, 300:780] = marker
    small = np.round(picture.reshape(225, 4, 300, 4).mean(axis=(1, 3))).astype(np.uint8)
    found = marker_finder("4X4_50")(small)
    corners = np.array([[75.0, 50.0], [195.0, 50.0], [195.0, 170.0], [75.0, 170.0]])
    assert list(found) == [7] and np.abs(found[7] - corners).max() < 0.1
    assert marker_finder("5X5_50")(small) == {}
    double = np.concatenate([small, small], axis=1)
    assert marker_finder("4X4_50")(double) == {}, "which of two equal markers is meant is not known"


def test_a_marker_on_a_wall_gives_meters(tmp_path: Path) -> None:
    """Three photographs of a room with a marker of 0.6 m and their poses in another unit."""
    cv2 = pytest.importorskip("cv2")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker = cv2.aruco.generateImageMarker(dictionary, 3, 300)[::-1] / 255.0  # walls count from the floor
    textures = np.full((6, 1000, 1200), 0.8)  # the back wall, 3 m away, has 4 x 2.5 m
    textures[3, 400:640, 480:660] = cv2.resize(marker, (180, 240), interpolation=cv2.INTER_NEAREST)
    folder = PreparationFolder(tmp_path / "capture")
    where = [look_at(np.array([x, 0.5, 1.2]), np.array([1.9, 3.0, 1.3])) for x in (1.0, 1.9, 2.9)]
    tenths = np.array(where)
    tenths[:, :3, 3] *= 0.1
    for number in (1, 2, 3):
        copy = folder.solve / "copies" / copy_name(f"v{number}")
        copy.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(tone_mapped(photograph(where[number - 1], textures))).save(copy, quality=95)
    write_model(folder.model, placed_model(tenths))
    preparation = single(tmp_path, ("v1", "v2", "v3"), (WIDTH, HEIGHT))

    def run(**settings: object) -> dict:
        run_with(folder, preparation, ["scale"], scale="marker", scale_length=0.6, **settings)
        return facts(folder, "scale")

    found = run()
    assert found["meters_per_unit"] == pytest.approx(10.0, rel=0.02) and found["difference"] < 0.03
    places = poses(read_model(folder.sparse))[:, :3, 3]
    expected = np.linalg.norm(where[0][:3, 3] - where[2][:3, 3])
    assert np.linalg.norm(places[0] - places[2]) == pytest.approx(expected, rel=0.02)
    assert error_of(run, marker_dictionary="5X5_50").code == "marker-missing"
    assert np.array_equal(poses(read_model(folder.sparse))[:, :3, 3], places)
