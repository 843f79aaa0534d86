"""Cameras solved from merged images: poses, views that are left out and why, existing solves, resuming."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import tone_mapped
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import Lens, Rig, RigView
from fipt_blender.core.run.messages import Reporter
from fipt_blender.prepare.lens import FULL_FRAME_DIAGONAL
from fipt_blender.prepare.preparation import Preparation, PreparationFolder
from fipt_blender.prepare.solve_step import model_from_rig, read_model, write_model
from fipt_blender.prepare.solving import (
    Connections,
    SolveView,
    camera_groups,
    copy_name,
    database_error,
    image_pairs,
    left_out,
    own_sizes,
    solve,
)
from samples import textured_room
from samples.camera_poses import look_at
from samples.prepared_captures import facts, run_with, single
from samples.refusals import error_of
from samples.textured_room import FOCAL, HEIGHT, WIDTH

FOCAL_35MM = FOCAL * FULL_FRAME_DIAGONAL / float(np.hypot(WIDTH, HEIGHT))
TARGET = np.array([1.6, 3.0, 1.1])
Solved = tuple[PreparationFolder, Preparation, Reporter]


def poses(count: int) -> list[np.ndarray]:
    """Level and tilted cameras on an arc, which look at the middle of a wall."""
    steps = np.linspace(-0.9, 0.9, count)
    return [
        look_at(
            np.array([2.0 + 1.2 * np.sin(step), 0.9 + 0.3 * np.cos(3.0 * step), 1.2 + 0.3 * np.sin(5 * step)]),
            TARGET + [0.4 * step, 0.0, 0.2 * np.cos(7.0 * step)],
        )
        for step in steps
    ]


def room_images(name: str, count: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Photographs of a room, whose walls depend on the seed."""
    walls = textured_room.wall_textures(seed)
    return {f"{name}{index}": textured_room.photograph(pose, walls) for index, pose in enumerate(poses(count))}


def write_capture(
    folder: PreparationFolder, images: dict[str, np.ndarray], models: Mapping[str, str] = {}
) -> Preparation:
    """Merged images and the prepare.json of a folder as the step merge leaves it; `models` are cameras."""
    for name, pixels in images.items():
        write_exr(folder.images / f"{name}.exr", pixels)
    made = single(folder.root / "photographs", images, (WIDTH, HEIGHT), focal_35mm=FOCAL_35MM)
    named = (replace(item, model=models.get(item.path.removesuffix(".jpg"), "")) for item in made.photographs)
    return replace(made, photographs=tuple(named))


def run(folder: PreparationFolder, preparation: Preparation, **settings: object) -> Reporter:
    """Solve and scale with some settings; returns what was reported."""
    return run_with(folder, preparation, ["solve", "scale"], **settings)


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Solved:
    """A capture of seven views of one room, three of another one, and one without any feature."""
    folder = PreparationFolder(tmp_path_factory.mktemp("solve") / "capture")
    images = room_images("room ", 7)
    # The other room is eight stops darker, with values that differ by much less than those of an 8-bit image.
    images |= {name: pixels / 256.0 for name, pixels in room_images("hall ", 3, seed=2).items()}
    images["blank"] = np.full((HEIGHT, WIDTH, 3), 0.3, np.float32)
    preparation = write_capture(folder, images, {"blank": "Another Camera"})
    return folder, preparation, run(folder, preparation)


def picks(points: list[np.ndarray], views: list[int]) -> str:
    """Where views of the room see points, as the user would pick them."""
    where = poses(7)
    texts = []
    for point in points:
        positions = [(view, textured_room.project(point, where[view])) for view in views]
        texts.append(", ".join(f"room {view} {x:.2f} {y:.2f}" for view, (x, y) in positions))
    return "; ".join(texts)


def centers(folder: PreparationFolder) -> dict[str, np.ndarray]:
    """Positions of the solved cameras by view, as the capture's reader finds them."""
    rig = read_rig(folder.root, "colmap", CaptureOptions())
    return {view.name: view.camera_to_world[:3, 3] for view in rig.views}


def distances(places: list[np.ndarray]) -> np.ndarray:
    return np.array([np.linalg.norm(a - b) for a, b in combinations(places, 2)])


def test_the_largest_room_is_solved_and_the_rest_is_told(solved: Solved) -> None:
    folder, _, reporter = solved
    found = facts(folder, "solve")
    assert [view["name"] for view in found["registered"]] == [f"room {index}" for index in range(7)]
    assert found["models"][0] == 7 and found["reprojection_error"] < 1.0
    assert all(view["points"] > 50 and view["reprojection_error"] < 1.0 for view in found["registered"])
    reasons = {item["name"]: item["reason"] for item in found["left_out"]}
    assert set(reasons) == {"hall 0", "hall 1", "hall 2", "blank"}
    assert "plain surfaces" in reasons["blank"]
    codes = {warning["code"] for warning in reporter.warnings}
    assert {"solve-left-out", "solve-split", "scale-unknown"} <= codes
    left = next(item for item in reporter.warnings if item["code"] == "solve-left-out")
    assert left["text"].startswith("4 of 11 photographs") and "working width" in left["remedy"]
    few = next(item for item in reporter.warnings if item["code"] == "camera-few-views")
    assert few["text"].startswith("'blank': ")
    assert sum("not connected" in reasons[f"hall {index}"] for index in range(3)) >= 2


def test_two_picked_points_give_meters(solved: Solved) -> None:
    folder, preparation, _ = solved
    before = folder.facts("solve").stat().st_mtime_ns
    first, second = np.array([1.0, 3.0, 0.8]), np.array([2.4, 3.0, 1.5])
    length = float(np.linalg.norm(first - second))
    true = [pose[:3, 3] for pose in poses(7)]
    for views, tolerance in (([0, 3, 6], 0.02), ([3], 0.05)):  # where rays meet; at the depth of points near
        reporter = run(
            folder, preparation, scale="points", scale_length=length, scale_picks=picks([first, second], views)
        )
        found = centers(folder)
        measured = distances([found[f"room {index}"] for index in range(7)])
        assert np.abs(measured / distances(true) - 1.0).max() < tolerance
        heights = [found[f"room {index}"][2] for index in range(7)]
        assert np.abs(np.array(heights) - [place[2] for place in true]).max() < 0.6  # above the floor
        assert np.corrcoef(heights, [place[2] for place in true])[0, 1] > 0.98  # Z is up
        assert "scale-unknown" not in {warning["code"] for warning in reporter.warnings}
    assert folder.facts("solve").stat().st_mtime_ns == before, "the cameras are not solved again"


def test_the_transform_to_a_mesh_is_applied_as_it_is(solved: Solved) -> None:
    folder, preparation, _ = solved
    run(folder, preparation, scale="mesh", scale_matrix="1 0 0 0 0 1 0 0 0 0 1 0")
    plain = centers(folder)
    run(folder, preparation, scale="mesh", scale_matrix="0 -2 0 5, 2 0 0 6, 0 0 2 7, 0 0 0 1")
    moved = centers(folder)
    for name, place in plain.items():
        expected = 2.0 * np.array([-place[1], place[0], place[2]]) + [5.0, 6.0, 7.0]
        assert np.allclose(moved[name], expected)
    assert facts(folder, "scale")["meters_per_unit"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ({"scale": "points", "scale_length": 0.0, "scale_picks": "room 1 5 5; room 1 9 9"}, "scale-length"),
        ({"scale": "points", "scale_length": 1.0, "scale_picks": "room 1 5 5"}, "scale-picks"),
        ({"scale": "points", "scale_length": 1.0, "scale_picks": "blank 5 5; room 1 9 9"}, "scale-view"),
        ({"scale": "mesh", "scale_matrix": "1 0 0 0 0 1 0 0 0 0 -1 0"}, "scale-matrix"),
        ({"scale": "marker", "scale_length": 1.0, "marker_dictionary": "9X9"}, "marker-dictionary"),
    ],
)
def test_a_wrong_scale_is_refused_and_the_cameras_stay(solved: Solved, settings: dict[str, object], code: str) -> None:
    folder, preparation, _ = solved
    before = centers(folder)
    caught = error_of(run, folder, preparation, **settings)
    assert caught.code == code and caught.remedy
    after = centers(folder)
    assert all(np.array_equal(after[name], before[name]) for name in before)
    assert not [path for path in (folder.root / "sparse").iterdir() if path.name != "0"]


def test_an_existing_solve_is_taken(solved: Solved, tmp_path: Path) -> None:
    """A solve of larger copies that bear the names of the photographs, in another format."""
    folder = PreparationFolder(tmp_path / "capture")
    preparation = write_capture(folder, room_images("g", 3))
    frames = [
        {"file_path": f"images/{name}.jpg", "transform_matrix": (pose @ np.diag([1, -1, -1, 1])).tolist()}
        for name, pose in zip(("g0", "g1", "another"), poses(3), strict=True)
    ]
    rig = {"fl_x": 2 * FOCAL, "fl_y": 2 * FOCAL, "cx": WIDTH, "cy": HEIGHT, "w": 2 * WIDTH, "h": 2 * HEIGHT}
    (tmp_path / "transforms.json").write_text(json.dumps({**rig, "frames": frames}), encoding="utf-8")
    matrix = "1 0 0 0 0 1 0 0 0 0 1 0"
    reporter = run(folder, preparation, cameras=str(tmp_path), scale="mesh", scale_matrix=matrix)
    views = {view.name: view for view in read_rig(folder.root, "colmap", CaptureOptions()).views}
    assert set(views) == {"g0", "g1"}
    for index in range(2):
        view = views[f"g{index}"]
        assert np.allclose(view.camera_to_world, poses(3)[index], atol=1e-6)
        assert (view.width, view.height) == (WIDTH, HEIGHT)
        assert view.lens.parameters[0] == pytest.approx(FOCAL)
    assert "solve-left-out" in {warning["code"] for warning in reporter.warnings}


class CutOff:
    """A model of which only a part fits onto the disk."""

    def __init__(self, model: pycolmap.Reconstruction) -> None:
        self._model = model

    def write_binary(self, folder: str) -> None:
        self._model.write_binary(folder)
        path = Path(folder) / "images.bin"
        path.write_bytes(path.read_bytes()[:-20])


def test_a_model_that_was_cut_off_replaces_no_other(tmp_path: Path) -> None:
    model = model_from_rig(rig_of(300, 200, "a"), [SolveView("a", 300, 200, files=("a",))])
    folder = tmp_path / "sparse" / "0"
    write_model(folder, model)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert error_of(write_model, folder, CutOff(model)).code == "disk-full"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list(folder.parent.iterdir()) == [folder]
    assert read_model(folder).num_reg_images() == 1


def rig_of(width: int, height: int, name: str) -> Rig:
    view = RigView(name, None, Path(name), width, height, Lens("PINHOLE", (9.0, 9.0, 5.0, 5.0)), np.eye(4))
    return Rig("colmap", (view,), None, None)


@pytest.mark.parametrize(
    ("rig", "code"), [(rig_of(300, 200, "b"), "solve-foreign"), (rig_of(200, 300, "a"), "solve-size")]
)
def test_a_solve_of_other_photographs_is_refused(rig: Rig, code: str) -> None:
    assert error_of(model_from_rig, rig, [SolveView("a", 300, 200, files=("a",))]).code == code


def write_copies(folder: Path, count: int) -> list[SolveView]:
    """The copies of a room that a solve starts from."""
    (folder / "copies").mkdir(parents=True)
    for name, pixels in room_images("v", count).items():
        Image.fromarray(tone_mapped(pixels)).save(folder / "copies" / copy_name(name), quality=95)
    return [SolveView(f"v{index}", WIDTH, HEIGHT, focal=FOCAL) for index in range(count)]


def test_a_stopped_solve_goes_on_where_it_stood(tmp_path: Path) -> None:
    views = write_copies(tmp_path, 3)

    def stop(share: float) -> None:
        if share > 0.5:  # after features and matches
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(tmp_path, views, 0, stop)
    with sqlite3.connect(tmp_path / "database.db") as database:
        database.execute("update keypoints set rows = rows")  # it is not locked
        before = database.execute("select * from two_view_geometries").fetchall()
        assert len(before) == 3
    database.close()
    found = solve(tmp_path, views, 0, lambda share: None)
    assert found.sizes == (3,) and found.left_out == ()
    with sqlite3.connect(tmp_path / "database.db") as database:
        assert database.execute("select * from two_view_geometries").fetchall() == before
        assert database.execute("select count(*), max(image_id) from images").fetchone() == (3, 3)
    database.close()
    assert {path.name for path in tmp_path.iterdir()} == {"copies", "database.db"}


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[bindings] SQLite error: database or disk is full", "disk-full"),
        ("/home/me/full frame/solve/database.db: SQLite error: disk I/O error", "solve-database"),
    ],
)
def test_a_full_disk_is_what_sqlite_says(text: str, code: str) -> None:
    assert database_error(Path("database.db"), RuntimeError(text)).code == code


def test_a_damaged_database_is_named(tmp_path: Path) -> None:
    views = write_copies(tmp_path, 2)
    (tmp_path / "database.db").write_bytes(b"not a database" * 100)
    caught = error_of(solve, tmp_path, views, 0, lambda share: None)
    assert caught.code == "solve-database" and "database.db" in caught.text


def test_without_overlap_the_solve_says_so(tmp_path: Path) -> None:
    """Two photographs of different walls; nothing of the capture is written."""
    folder = PreparationFolder(tmp_path / "capture")
    preparation = write_capture(folder, room_images("one wall ", 1, seed=3) | room_images("other wall ", 1, seed=4))
    caught = error_of(run, folder, preparation)
    assert caught.code == "solve-failed" and "2 match no other one" in caught.text
    assert not (folder.root / "sparse").exists() and not folder.facts("solve").exists()
    refusal = error_of(solve, tmp_path, [SolveView("wall 3", WIDTH, HEIGHT)], 0, lambda share: None)
    assert refusal.code == "solve-few"


def test_solving_needs_merged_images(tmp_path: Path) -> None:
    folder = PreparationFolder(tmp_path / "capture")
    preparation = write_capture(folder, {"a": np.ones((HEIGHT, WIDTH, 3), np.float32)})
    (folder.images / "a.exr").unlink()
    caught = error_of(run, folder, preparation)
    assert caught.code == "image-missing" and "merge" in caught.remedy


def test_many_photographs_are_compared_with_near_ones_and_loops_are_closed() -> None:
    count = 400
    pairs = image_pairs(count)
    assert len(set(pairs)) == len(pairs) < 0.15 * count * count / 2
    assert all(0 <= first < second < count for first, second in pairs)
    assert {(7, 8), (7, 17), (7, 71), (0, 392)} <= set(pairs)
    assert {index for pair in pairs for index in pair} == set(range(count))


def test_cameras_are_shared_by_lens_and_format() -> None:
    view = SolveView("a", 300, 200, "x", 250.0)
    views = [view, replace(view, focal=250.02), replace(view, width=200, height=300)]
    views += [replace(view, camera="y"), replace(view, focal=400.0), replace(view, focal=None)]
    assert camera_groups(views) == [[0, 1], [2], [3], [4], [5]]


def test_reasons_for_views_without_a_camera() -> None:
    names = ["placed", "elsewhere", "blurred", "alone", "weak"]
    views = [SolveView(name, 8, 8) for name in names]
    found = [Connections(900, 3), Connections(900, 2), Connections(20, 0), Connections(900, 0)]
    items = left_out(views, [{"placed"}, {"elsewhere", "more"}], [*found, Connections(900, 2)])
    assert [item.name for item in items] == names[1:]
    for item, words in zip(items, ("not connected", "20 features", "nothing", "too little"), strict=True):
        assert words in item.reason and item.remedy


def test_copies_have_the_same_contrast_in_the_dark() -> None:
    generator = np.random.default_rng(0)
    radiance = generator.uniform(0.1, 1.0, (40, 60, 3)).astype(np.float32)
    assert np.array_equal(tone_mapped(radiance), tone_mapped(radiance * np.float32(2.0**-9)))
    assert tone_mapped(radiance).std() > 50.0
    assert not tone_mapped(np.zeros((4, 4, 3), np.float32)).any()


def test_a_model_of_photographs_that_a_larger_one_has_is_no_set_of_its_own() -> None:
    assert own_sizes([{"a", "b", "c"}, {"b", "c"}]) == (3,)
    assert own_sizes([{"a", "b", "c"}, {"c", "d", "e"}, {"f", "g"}]) == (3, 2, 2)
