"""Complete estimations of a tiny lit box: correct, equal after kills and under changed settings, clear errors."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.tracer.environment import EnvironmentLight
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.light import baking
from fipt_blender.core.material import training
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.pixels.store import trace_view
from fipt_blender.core.run import finished_views
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.refusals import error_of
from samples.small_captures import (
    COLORS,
    FEW,
    HEIGHT,
    PANEL_RADIANCE,
    PANEL_TRIANGLES,
    QUICK,
    UNTRAINED,
    WIDTH,
    SmallCapture,
    few_sources,
    fixtures_of,
    matt,
    outcome,
    panel_capture,
    photograph_room,
    run_here,
    some_views,
    stages_of,
    warnings_of,
    write_run,
)
from samples.small_rooms import BOX, make_room, surface_points

ROOT = Path(__file__).resolve().parent.parent
STAGES = [
    *("pixels", "checks", "unmixing", "outside", "shadings", "estimate-0"),
    *("reflection-1", "refinement-1", "estimate-1", "training"),
]
# Of runs whose networks learn next to nothing, such that each setting has an effect.
BASE = {**QUICK, **UNTRAINED, **FEW, "batch_size": 256, "rounds": 0}


def killed(run: RunFolder, kill: Callable[[dict], bool]) -> list[dict]:
    """Messages of a child process like Blender's; SIGKILL at the first one for which `kill` is true."""
    command = [sys.executable, "-m", "fipt_blender.core", "estimate", str(run.root)]
    messages = []
    with (run.root / "log.txt").open("a") as log:
        child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True)
        assert child.stdout is not None
        for line in child.stdout:
            message = parse_message(line)
            assert message is not None, f"no message: {line}"
            messages.append(message)
            if kill(message):
                os.kill(child.pid, signal.SIGKILL)
                break
        child.stdout.close()
        assert child.wait() == -signal.SIGKILL, messages[-1]
        return messages


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return panel_capture()


@pytest.fixture(scope="module")
def finished(capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, list[dict]]:
    """One uninterrupted run, and its messages."""
    run = write_run(tmp_path_factory.mktemp("finished") / "run", capture)
    return run, run_here(run)


def work(run: RunFolder) -> list[str]:
    """Run the estimation; returns the stages that were done."""
    return stages_of(run_here(run, train=False))


@pytest.fixture(scope="module")
def fresh(capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RunFolder]:
    """Makes run folders of complete estimations with some settings, of a few of the views."""

    @cache
    def make(**changes: Any) -> RunFolder:
        run = write_run(tmp_path_factory.mktemp("run") / "run", some_views(capture), **{**BASE, **changes})
        work(run)
        return run

    return make


def same(first: RunFolder, second: RunFolder) -> None:
    """Equal bit for bit."""
    one, other = outcome(first), outcome(second)
    assert one.keys() == other.keys() and [name for name in one if one[name] != other[name]] == []


def connected_room_without_a_wall() -> tuple[SmallCapture, list]:
    """Gray walls of one connected mesh, lit by what no photograph shows; and their base colours."""
    colors = [[0.7, 0.68, 0.66], [0.8] * 3, [0.3] * 3, [0.55] * 3, [0.45, 0.45, 0.46]]
    room = make_room([*BOX[:4], BOX[5]], parts="semantics", objects=np.zeros(5, int))
    places = [(-1.5, 1.7), (0.0, 0.6), (1.5, 2.2), (-0.7, 2.4)]
    cameras = [[[1.8, y, z], [-2.0, -0.7 * y, 3.0 - z]] for y, z in places]
    outside = EnvironmentLight(np.tile(np.array([3.0, 3.5, 4.0], np.float32), (8, 16, 1)))
    return photograph_room(room, matt(np.repeat(colors, 2, axis=0)), EmitterTable.empty(), outside, cameras), colors


def color_errors(run: RunFolder, room: Room, colors: list | np.ndarray) -> np.ndarray:
    """Mean absolute error of base colour on each wall, of these colours."""
    walls = len(colors)
    points, _, triangle = surface_points(room, 200, np.random.default_rng(0), np.arange(2 * walls))
    color, _, metallic = RoomFields.load(run).query(points, triangle)
    wrong = np.abs(color * (1 - metallic[:, None]) - np.array(colors)[triangle // 2]).mean(axis=1)
    return wrong.reshape(walls, -1).mean(axis=1)


def test_it_speaks_of_every_stage_and_names_its_files(finished) -> None:
    run, messages = finished
    stages = [message for message in messages if message["type"] == "stage"]
    assert messages[0]["type"] == "note" and "megapixels; about" in messages[0]["text"]
    assert [stage["name"] for stage in stages[:-10]] == ["cleaning", "relation", "completion", "linking", "outlines"]
    listed = [(stage["name"], stage["index"], stage["count"]) for stage in stages[-10:]]
    assert listed == [(name, index, 10) for index, name in enumerate(STAGES)]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] <= 1.0
    assert messages[-1]["type"] == "done"
    assert {Path(file).name for file in messages[-1]["files"]} == {
        "fields.npz", "parts.json", "emitters.json", "statistics.json",
    }  # fmt: skip
    assert all(Path(file).exists() for file in messages[-1]["files"])
    statistics = json.loads(run.statistics_json.read_text())
    assert [stage["name"] for stage in statistics["stages"]] == STAGES
    assert all(stage["seconds"] > 0 for stage in statistics["stages"])
    assert not [path for path in run.root.rglob(".*") if path.is_file()]  # no temporary file is left


def test_the_panel_is_found_with_its_radiance(finished) -> None:
    (fixture,) = fixtures_of(finished[0])
    assert fixture["triangles"] == PANEL_TRIANGLES
    assert json.loads(finished[0].emitters_json.read_text())["environment"] is None
    assert fixture["radiance"] == pytest.approx(PANEL_RADIANCE, rel=1e-3)
    assert fixture["back_radiance"] == [0.0, 0.0, 0.0]
    assert fixture["area"] == pytest.approx(1.96) and fixture["centroid"] == pytest.approx([0.0, 0.0, 2.9])
    assert fixture["power"] == pytest.approx(np.multiply(PANEL_RADIANCE, np.pi * 1.96), rel=1e-3)


def test_base_colours_are_near_the_truth(finished, capture: SmallCapture) -> None:
    errors = color_errors(finished[0], capture.room, COLORS)
    assert errors.mean() < 0.06 and errors.max() < 0.12


def test_killed_at_any_time_it_ends_bit_for_bit_the_same(
    finished, capture: SmallCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed while overwriting shadings, and interrupted in training after a checkpoint."""
    run = write_run(tmp_path / "run", capture)

    def amid_refinement(message: dict) -> bool:
        half_done = message["type"] == "progress" and 0.45 < message["stage_fraction"] < 1.0
        return half_done and (run.stage / "refinement-1").exists()

    def save_and_stop(*arguments) -> None:
        save_tensors(*arguments)
        raise KeyboardInterrupt

    assert STAGES[0] in stages_of(killed(run, amid_refinement)) and not run.fields_npz.exists()
    save_tensors = training.save_tensors
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(training, "save_tensors", save_and_stop)
        run_here(run)
    assert not run.fields_npz.exists()
    assert stages_of(run_here(run)) == ["training"]
    same(finished[0], run)
    # Once more: nothing is left to do, and nothing changes.
    assert stages_of(run_here(run)) == []
    same(finished[0], run)


def test_views_baked_before_a_kill_are_not_baked_again(
    fresh, capture: SmallCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = write_run(tmp_path / "run", some_views(capture), **{**BASE, "rounds": 1})
    bake_view = baking.bake_view
    baked: list[int]

    def bake(*arguments):
        if len(baked) == limit:
            raise KeyboardInterrupt
        baked.append(arguments[-1].index)
        return bake_view(*arguments)

    monkeypatch.setattr(finished_views, "NOTE_SECONDS", 0.0)
    monkeypatch.setattr(baking, "bake_view", bake)
    # While the fourth view is traced, the third one may still be denoised in another thread.
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    every = [0, 1, 2, 3]
    # In the first shadings, then twice in the refinement.
    for stop, expected in ((3, every[:3]), (5, [*every[2:], *every[:3]]), (1, every[2:3])):
        baked, limit = [], stop
        with pytest.raises(KeyboardInterrupt):
            run_here(run, train=False)
        assert baked == expected
    (run.stage / "refinement-1" / "diffuse.npy").write_bytes(b"cut off")
    baked, limit = [], -1
    run_here(run, train=False)
    assert baked == every
    same(fresh(rounds=1), run)


@pytest.mark.parametrize(
    "length, radiance, shift",
    [(100.0, 1000.0, (0.0, 0.0, 0.0)), (0.01, 0.001, (10.0, -6.0, 3.0))],
    ids=["large and bright", "small, dark and far away"],
)
def test_nothing_depends_on_unit_exposure_or_place(
    fresh, capture: SmallCapture, tmp_path: Path, length: float, radiance: float, shift: tuple
) -> None:
    run = write_run(tmp_path / "run", some_views(capture).scaled(length, radiance, shift), **{**BASE, "rounds": 1})
    work(run)
    points, _, triangle = surface_points(capture.room, 200, np.random.default_rng(0), np.arange(12))
    color, roughness, _ = RoomFields.load(fresh(rounds=1)).query(points, triangle)
    other, other_roughness, _ = RoomFields.load(run).query(points * length + shift, triangle)
    assert np.abs(color - other).mean() < 0.01
    assert np.abs(roughness - other_roughness).mean() < 0.05
    (fixture,) = fixtures_of(run)
    assert fixture["triangles"] == PANEL_TRIANGLES
    assert fixture["radiance"] == pytest.approx(np.multiply(PANEL_RADIANCE, radiance), rel=1e-3)
    assert fixture["centroid"] == pytest.approx(np.array([0.0, 0.0, 2.9]) * length + shift, abs=2e-3 * length)


def test_paths_without_a_cache_still_find_materials(capture: SmallCapture, tmp_path: Path) -> None:
    """One of the paper's ablations."""
    run = write_run(tmp_path / "run", some_views(capture), refine_cache=False, **UNTRAINED, **FEW)
    run_here(run, train=False)
    assert [lamp["triangles"] for lamp in fixtures_of(run)] == [PANEL_TRIANGLES]
    assert color_errors(run, capture.room, COLORS).mean() < 0.1


def test_lamps_that_are_painted_out_are_a_warning(finished, capture: SmallCapture, tmp_path: Path) -> None:
    brightest = max(image.max() for image in capture.images)

    def painted(image: np.ndarray) -> np.ndarray:
        lamp = image.max(axis=2, keepdims=True) > 0.5 * brightest
        return np.where(lamp, np.median(image), image).astype(np.float32)

    images = [painted(image) for image in capture.images]
    run = write_run(tmp_path / "run", replace(capture, images=images), rounds=0, **UNTRAINED, **FEW)
    assert "light-missing" in warnings_of(run_here(run, train=False))
    assert warnings_of(finished[1]) == []


def away(capture: SmallCapture) -> SmallCapture:
    """Cameras outside the room that look away from it."""
    return replace(capture, poses=[look_at([9.0, i, 1.0], [20.0, i, 1.5]) for i in range(len(capture.poses))])


def without_faces(capture: SmallCapture) -> SmallCapture:
    names = ("triangles", "corner_normals", "triangle_object", "triangle_material")
    return replace(capture, room=replace(capture.room, **{name: getattr(capture.room, name)[:0] for name in names}))


@pytest.mark.parametrize(
    "spoil, changes, code",
    [
        (without_faces, {}, "mesh-empty"),
        (away, {}, "mesh-unseen"),
        (lambda capture: replace(capture, images=[image * 0.0 for image in capture.images]), {}, "images-black"),
        (lambda capture: replace(capture, images=[], poses=[]), {}, "views-none"),
        (lambda capture: capture, {"version": 99}, "run-version"),
    ],
)
def test_input_that_can_not_be_used(
    spoil: Callable, changes: dict, code: str, capture: SmallCapture, tmp_path: Path
) -> None:
    run = write_run(tmp_path / "run", spoil(capture))
    data = json.loads(run.run_json.read_text())
    run.run_json.write_text(json.dumps({**data, **changes}))
    assert error_of(run_here, run).code == code
    assert not any(run.results.iterdir())


def test_classes_tell_walls_of_one_piece_apart_where_light_enters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The light from directions that no photograph shows follows from surfaces of one albedo each."""
    few_sources(monkeypatch)
    capture, colors = connected_room_without_a_wall()
    run = write_run(tmp_path / "run", capture, rounds=0, unseen_light=True, environment_width=32, **UNTRAINED)
    data = json.loads(run.capture_json.read_text())
    for view, camera in zip(data["views"], load_capture(run).train, strict=True):
        triangle = trace_view(capture.room, camera).triangle.reshape(HEIGHT, WIDTH)
        view["semantics"] = f"images/{Path(view['image']).stem}.png"
        ids = np.where(triangle >= 0, triangle // 2 + 1, 0).astype(np.uint8)
        Image.fromarray(ids).save(run.root / view["semantics"])
    run.capture_json.write_text(json.dumps(data))
    run_here(run, train=False)
    assert json.loads(run.statistics_json.read_text())["part_kind"] == "semantic"
    assert color_errors(run, capture.room, colors).max() < 0.06  # 0.38 where all walls have one albedo
    # The light enters by lamps in the opening, whose power in all is that of the radiance outside.
    lamps = json.loads(run.emitters_json.read_text())["missing"]
    entering = [lamp for lamp in lamps if lamp["facing"] == [-1.0, 0.0, 0.0]]
    mean = sum(np.pi * lamp["radius"] ** 2 * np.array(lamp["radiance"]) for lamp in entering) / 12.0  # m2
    assert mean == pytest.approx([3.0, 3.5, 4.0], rel=0.15)


@pytest.mark.parametrize(
    ("before", "changes", "done"),
    [
        (0, {"unmix": False}, ["unmixing", *STAGES[3:6], "training"]),
        (1, {"rounds": 0}, ["shadings", "training"]),  # the refinement replaced the shadings of stage 1
        (1, {"rounds": 1, "shrink_detail": False, "checkpoint_steps": 7}, []),
        (1, {"rounds": 2}, ["reflection-2", "refinement-2", "estimate-2", "training"]),
    ],
)
def test_resumed_under_other_settings_equals_fresh(
    fresh, tmp_path: Path, before: int, changes: dict[str, Any], done: list[str]
) -> None:
    """What does not read a setting is kept."""
    copy = RunFolder(shutil.copytree(fresh(rounds=before).root, tmp_path / "run"))
    copy.create(make_settings("draft", {**BASE, **changes}))
    assert work(copy) == done
    same(copy, fresh(**changes))


def test_a_damaged_checkpoint_of_an_unfinished_training_is_discarded(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh(rounds=0).root, tmp_path / "run"))
    path = run.stage / "stages.json"
    data = json.loads(path.read_text())
    del data["stages"]["training"]
    path.write_text(json.dumps(data))
    (run.stage / "training" / "unfinished.pt").write_bytes(b"cut off")
    messages = run_here(run, train=False)
    assert stages_of(messages) == ["training"] and "checkpoint-damaged" in warnings_of(messages)
    same(run, fresh(rounds=0))


def test_a_changed_photograph_that_was_held_back_is_judged_again(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh(rounds=0).root, tmp_path / "run"))
    data = json.loads(run.capture_json.read_text())
    data["views"][1]["split"] = "held_back"
    run.capture_json.write_text(json.dumps(data))
    assert work(run)[-1] == "quality" and work(run) == []
    image = run.resolve(data["views"][1]["image"])
    os.utime(image, (0, 0))
    assert work(run) == ["quality"]
