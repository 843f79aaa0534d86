"""Input from which nothing can be estimated is refused before the stages; wrong poses are found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.checks.consensus import check_input
from fipt_blender.core.run.settings import make_settings
from samples.refusals import error_of
from samples.small_captures import CAMERAS, SmallCapture, matt, photograph_room, window_capture, write_run
from samples.small_rooms import BOX, make_room, table

SETTINGS = make_settings("draft")
TILES = 8  # of each wall


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    """A box of tiles of random colours and a lamp, twelve views of 96 x 64 pixels."""
    quads = []
    for quad in np.array(BOX, float):
        across, down = (quad[1] - quad[0]) / TILES, (quad[3] - quad[0]) / TILES
        corners = [quad[0] + i * across + j * down for i in range(TILES) for j in range(TILES)]
        quads += [[c, c + across, c + across + down, c + down] for c in corners]
    lamp = len(quads)
    quads.append(np.array([[-0.7, -0.7, 2.9], [-0.7, 0.7, 2.9], [0.7, 0.7, 2.9], [0.7, -0.7, 2.9]]))
    colors = np.random.default_rng(0).uniform(0.1, 0.8, (len(quads), 3))
    room = make_room([np.asarray(quad).tolist() for quad in quads])
    lamps = table([2 * lamp, 2 * lamp + 1], [6.0, 5.0, 4.0])
    others = [[[-x, y, z], [-a, b, 3.0 - c]] for (x, y, z), (a, b, c) in CAMERAS]
    materials = matt(np.repeat(colors, 2, axis=0))
    made = photograph_room(room, materials, lamps, cameras=[*CAMERAS, *others], scale=2, spp=32)
    return made.scaled(1.0, 1.0, (1.5, 1.0, 0.3))  # a box is its own mirror image about its middle


@pytest.fixture(scope="module")
def views(capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory) -> list[View]:
    return load_capture(write_run(tmp_path_factory.mktemp("run"), capture)).train


def disturbed(views: list[View], chosen: list[int]) -> list[View]:
    """The views with poses that are wrong by 15 degrees and 0.3 m."""
    result, rng = list(views), np.random.default_rng(3)
    for index in chosen:
        axis, away = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        pose = views[index].camera_to_world.copy()
        pose[:3, :3] = pose[:3, :3] @ turn_by(np.radians(15.0) * axis)
        pose[:3, 3] += 0.3 * away
        result[index] = replace(views[index], camera_to_world=pose)
    return result


def paired(views: list[View]) -> list[View]:
    """Each view twice, from nearly one place."""
    pairs = []
    for view in views:
        beside = view.camera_to_world.copy()
        beside[:3, 3] += 0.002
        pairs += [view, replace(view, name=f"{view.name}~2", camera_to_world=beside)]
    return pairs


def refused(code: str, capture: SmallCapture, views: list[View], vertices: np.ndarray | None = None) -> str:
    """The error's text and remedy; forced, there is none."""
    room = capture.room
    if vertices is not None:
        room = replace(room, vertices=vertices.astype(np.float32))
    error = error_of(check_input, room, views, SETTINGS)
    assert error.code == code and "--force" in error.remedy
    check_input(room, views, make_settings("draft", {"force": True}))
    return f"{error.text} {error.remedy}"


@pytest.mark.parametrize("count", [2, 12])
def test_good_input_passes_with_few_views(capture: SmallCapture, views: list[View], count: int) -> None:
    assert check_input(capture.room, views[:count], SETTINGS) == {}


def test_a_plain_room_passes(tmp_path: Path) -> None:
    plain = window_capture([3.0, 3.0, 3.0])
    assert check_input(plain.room, load_capture(write_run(tmp_path, plain)).train, SETTINGS) == {}


@pytest.mark.parametrize("chosen", [[4], [0, 2, 5, 7, 9, 11]])
def test_wrong_poses_are_found_up_to_half(capture: SmallCapture, views: list[View], chosen: list[int]) -> None:
    assert sorted(check_input(capture.room, disturbed(views, chosen), SETTINGS)) == chosen


def test_a_wrong_exposure_is_no_wrong_pose(capture: SmallCapture, tmp_path: Path) -> None:
    images = [image * np.float32(3.0 if i % 3 == 0 else 1.0) for i, image in enumerate(capture.images)]
    views = load_capture(write_run(tmp_path, replace(capture, images=images))).train
    assert check_input(capture.room, views, SETTINGS) == {}


def test_noise_is_no_wrong_pose(capture: SmallCapture, tmp_path: Path) -> None:
    """Photographs that are mostly noise correlate with none; a few clear ones are not enough to judge."""
    rng = np.random.default_rng(5)
    noisy = [image * rng.lognormal(0.0, 2.0, (*image.shape[:2], 1)) for image in capture.images]
    images = [*capture.images[:2], *(image.astype(np.float32) for image in noisy[2:])]
    views = load_capture(write_run(tmp_path, replace(capture, images=images))).train
    assert check_input(capture.room, views, SETTINGS) == {}


def test_a_mirrored_mesh_and_a_wrong_unit_are_named(capture: SmallCapture, views: list[View]) -> None:
    vertices = capture.room.vertices
    assert "mirrored along X" in refused("mesh-misplaced", capture, views, vertices * (-1.0, 1.0, 1.0))
    assert "scaled by 0.001" in refused("mesh-misplaced", capture, views, vertices * 1000.0)
    turned = vertices[:, [0, 2, 1]] * (1.0, 1.0, -1.0)
    assert "turned by" in refused("mesh-misplaced", capture, views, turned)


def test_poses_or_mesh_are_blamed_by_evidence(capture: SmallCapture, views: list[View]) -> None:
    """Pairs of cameras at nearly one place tell which: a wrong mesh hardly matters to them."""
    pairs = paired(views)
    rng = np.random.default_rng(2)
    wrong = capture.room.vertices * np.float32([1.0, 1.0, 0.6]) + np.float32([0.8, -0.7, 0.9])
    wrong = wrong + rng.normal(0.0, 0.25, wrong.shape)
    assert "the mesh is wrong" in refused("views-disagree", capture, pairs, wrong)
    assert "the poses are wrong" in refused("views-disagree", capture, disturbed(views, list(range(12))))


def test_a_mesh_that_these_cameras_measured_is_not_told_to_move(capture: SmallCapture, views: list[View]) -> None:
    room = replace(capture.room, vertices=capture.room.vertices * np.float32(1000.0))
    assert error_of(check_input, room, views, SETTINGS).code == "mesh-misplaced"
    assert error_of(check_input, room, views, SETTINGS, own_mesh=True).code != "mesh-misplaced"


def test_with_a_mesh_of_these_cameras_wrong_poses_are_left_out_and_a_bad_mesh_stops_nothing(
    capture: SmallCapture, views: list[View]
) -> None:
    vertices = capture.room.vertices + np.random.default_rng(2).normal(0.0, 0.2, capture.room.vertices.shape)
    room, wrong = replace(capture.room, vertices=vertices.astype(np.float32)), disturbed(views, [0, 1, 2, 3])
    assert error_of(check_input, room, wrong, SETTINGS).code == "views-disagree"
    assert set(check_input(room, wrong, SETTINGS, own_mesh=True)) == {0, 1, 2, 3}
    most = disturbed(views, list(range(12)))
    assert error_of(check_input, room, most, SETTINGS, own_mesh=True).code == "views-disagree"
    pairs = paired(views)
    squeezed = capture.room.vertices * np.float32([1.0, 1.0, 0.75]) + np.float32([0.3, -0.2, 0.3])
    room = replace(capture.room, vertices=squeezed)
    assert error_of(check_input, room, pairs, SETTINGS).code in ("views-disagree", "mesh-misplaced")
    assert check_input(room, pairs, SETTINGS, own_mesh=True) == {}


def test_input_that_tells_nothing(capture: SmallCapture, views: list[View], tmp_path: Path) -> None:
    assert "one photograph" in refused("input-insufficient", capture, views[:1])
    away = np.eye(4)  # far above the room, and looking upwards
    away[:3, 3] = 100.0, 100.0, 300.0
    outside = [view if i % 2 == 0 else replace(view, camera_to_world=away) for i, view in enumerate(views)]
    assert "6 of 12 cameras" in refused("input-insufficient", capture, outside)
    white = tmp_path / "white.exr"
    write_exr(white, np.ones((64, 96, 3), np.float32))
    assert "alike" in refused("input-insufficient", capture, [replace(view, image=white) for view in views])
    one = make_room([BOX[0]])
    refused("input-insufficient", replace(capture, room=replace(one, triangles=one.triangles[:1])), views)
