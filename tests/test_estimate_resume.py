# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Changed settings keep the stages that do not read them, and a resumed run equals a new one."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from fipt_blender.core.estimate import material_stages, stages
from fipt_blender.core.material import training
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import ESTIMATE, REFINEMENT, SHADINGS, TRAINING, Settings, make_settings
from samples.small_captures import QUICK, panel_capture, run_here, write_run

# Small enough to be quick, and such that each setting has an effect.
BASE = {**QUICK, "training_steps": 6, "batch_size": 512, "rounds": 0}
ALL = ["pixels", "shadings", "estimate-0", "refinement-1", "estimate-1", "training"]
# Values other than those of BASE where doubling is no legal change.
OTHERS = {
    "masking": "smith",
    "atlas_mode": "color_attribute",
    "atlas_images": "part",
    "write_back": "paper",
    "preset": "medium",
}


def changes(stage: str | None) -> dict[str, Any]:
    """Another value for each setting that `stage` is the first to read."""
    base = make_settings("draft", BASE)
    found = {}
    for item in fields(Settings):
        if item.metadata["stage"] != stage or item.name == "rounds":
            continue
        value = getattr(base, item.name)
        if isinstance(value, bool):
            found[item.name] = not value
        elif isinstance(value, int):
            found[item.name] = value + 1
        else:
            found[item.name] = OTHERS.get(item.name) or 1.25 * value
    return found


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def quick_start():
    """Few steps towards the closed-form guess: results need to be equal here, not good."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (training, material_stages):
            patch.setattr(module, "PRETRAINING_STEPS", 4)
        yield


@pytest.fixture(scope="module")
def capture():
    return panel_capture()


def work(run: RunFolder) -> list[str]:
    """Run the estimation; returns the stages that were done."""
    return [message["name"] for message in run_here(run) if message["type"] == "stage"]


@pytest.fixture(scope="module")
def fresh(quick_start, capture, tmp_path_factory: pytest.TempPathFactory):
    """Makes run folders of complete estimations, by rounds and by the stage whose settings are changed."""
    made: dict[tuple[int, str], RunFolder] = {}

    def make(rounds: int, stage: str | None = "") -> RunFolder:
        key = (rounds, str(stage))
        if key not in made:
            others = {} if stage == "" else changes(stage)
            root = tmp_path_factory.mktemp("run") / "run"
            made[key] = write_run(root, capture, **{**BASE, "rounds": rounds, **others})
            work(made[key])
        return made[key]

    return make


def resumed(run: RunFolder, folder: Path, rounds: int, stage: str | None) -> tuple[RunFolder, list[str]]:
    """A copy of a finished run, resumed with other settings, and the stages that were done."""
    copy = RunFolder(shutil.copytree(run.root, folder))  # keeps the times of the photographs
    copy.create(make_settings("draft", {**BASE, "rounds": rounds, **changes(stage)}))
    return copy, work(copy)


def arrays(folder: Path) -> dict[str, bytes]:
    """Content of each array file of a folder."""
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.npy"))}


def tensors(run: RunFolder, name: str) -> dict[str, bytes]:
    """What a closed-form estimate or the training has found."""
    state = torch.load(run.stage / f"{name}.pt", weights_only=True)
    groups = {key: value if isinstance(value, dict) else {"": value} for key, value in state.items()}
    return {f"{key}.{k}": v.numpy().tobytes() for key, group in groups.items() for k, v in group.items()}


def outcome(run: RunFolder) -> dict[str, bytes]:
    """The results, bit for bit."""
    with np.load(run.fields_npz, allow_pickle=False) as data:
        found = {name: data[name].tobytes() for name in data.files}
    return found | {"emitters": run.emitters_json.read_bytes()}


def test_stages_depend_on_no_setting_that_is_said_to_be_read_later(fresh) -> None:
    """Changing all settings of a stage keeps the stages before it."""
    none, one = fresh(0), fresh(1)
    assert arrays(fresh(0, SHADINGS).stage / "pixels") == arrays(none.stage / "pixels")
    other = fresh(0, ESTIMATE)
    assert arrays(other.stage / "pixels") == arrays(none.stage / "pixels")
    assert arrays(other.stage / "shadings") == arrays(none.stage / "shadings")
    assert outcome(other) != outcome(none)
    alone, refined = (tensors(run, "estimate-0") for run in (none, one))
    for_paths = {key for key in refined if key.partition(".")[0] in ("diffuse", "materials")}
    assert {key: alone[key] for key in alone.keys() - for_paths} == {
        key: refined[key] for key in refined.keys() - for_paths
    }, "only what serves stage 3 depends on the number of rounds"
    assert not any(alone[key] for key in for_paths) and all(refined[key] for key in for_paths)
    refinement = fresh(1, REFINEMENT)
    assert tensors(refinement, "estimate-0") == tensors(one, "estimate-0")
    assert arrays(refinement.stage / "shadings") != arrays(one.stage / "shadings")
    later = fresh(1, TRAINING)
    assert arrays(later.stage / "shadings") == arrays(one.stage / "shadings")
    assert tensors(later, "estimate-1") == tensors(one, "estimate-1")
    assert tensors(later, "training") != tensors(one, "training")
    shrunk = outcome(one)
    assert outcome(fresh(1, None)) == {key: shrunk[key] for key in shrunk if not key.startswith("detail_")}


@pytest.mark.parametrize(
    ("rounds_before", "rounds", "stage", "done"),
    [
        (0, 0, TRAINING, ["training"]),
        (0, 0, ESTIMATE, ["estimate-0", "training"]),
        (0, 0, SHADINGS, ["shadings", "estimate-0", "training"]),
        # The refinement wrote over stage 1's shadings.
        (1, 0, ESTIMATE, ["shadings", "estimate-0", "training"]),
        (1, 1, REFINEMENT, ["refinement-1", "estimate-1", "training"]),
        (1, 1, TRAINING, ["training"]),
        (1, 1, None, []),
    ],
)
def test_resumed_under_other_settings_equals_fresh(
    fresh, tmp_path: Path, rounds_before: int, rounds: int, stage: str | None, done: list[str]
) -> None:
    run, worked = resumed(fresh(rounds_before), tmp_path / "run", rounds, stage)
    assert worked == done
    assert outcome(run) == outcome(fresh(rounds, stage))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def other_tensors(path: Path) -> None:
    torch.save({"brdf": {"x": torch.ones(3)}}, path)


def without_values(path: Path) -> None:
    data = json.loads(path.read_text())
    path.write_text(json.dumps({**data, "values": {}}))


@pytest.mark.parametrize(
    ("name", "damage", "done"),
    [
        ("pixels/position.npy", cut, ALL),
        ("pixels/triangle.npy", Path.unlink, ALL),
        ("pixels/front.npy", lambda path: path.write_bytes(b""), ALL),
        ("shadings/diffuse.npy", cut, ALL[3:]),
        ("estimate-0.pt", cut, ALL[1:]),  # the refinement wrote over stage 1's shadings
        ("estimate-1.pt", other_tensors, ALL[4:]),
        ("training.pt", other_tensors, ALL[5:]),
        ("stages.json", without_values, ALL),
        ("stages.json", lambda path: path.write_text("[]"), ALL),
    ],
)
def test_a_damaged_checkpoint_is_discarded_and_its_stage_done_again(
    fresh, tmp_path: Path, name: str, damage, done: list[str]
) -> None:
    run = RunFolder(shutil.copytree(fresh(1).root, tmp_path / "run"))
    damage(run.stage / name)
    messages = run_here(run)
    assert [message["name"] for message in messages if message["type"] == "stage"] == done
    codes = [message["code"] for message in messages if message["type"] == "warning"]
    assert codes.count("checkpoint-damaged") == 1
    assert outcome(run) == outcome(fresh(1))
    assert work(run) == []


def test_a_damaged_checkpoint_of_an_unfinished_training_is_discarded(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh(0).root, tmp_path / "run"))
    path = run.stage / "stages.json"
    data = json.loads(path.read_text())
    del data["stages"]["training"]
    path.write_text(json.dumps(data))
    (run.stage / "unfinished.pt").write_bytes(b"cut off")
    messages = run_here(run)
    assert [message["name"] for message in messages if message["type"] == "stage"] == ["training"]
    assert "checkpoint-damaged" in [message.get("code") for message in messages]
    assert outcome(run) == outcome(fresh(0))


def test_another_number_of_rounds_keeps_those_that_are_done(fresh, tmp_path: Path) -> None:
    copy = RunFolder(shutil.copytree(fresh(1).root, tmp_path / "run"))
    copy.create(make_settings("draft", BASE))
    assert work(copy) == ["shadings", "estimate-0", "training"], (
        "the refinement wrote over stage 1's shadings"
    )
    assert outcome(copy) == outcome(fresh(0))
    copy.create(make_settings("draft", {**BASE, "rounds": 1}))
    assert work(copy) == ALL[2:] and outcome(copy) == outcome(fresh(1))
    copy.create(make_settings("draft", {**BASE, "rounds": 2}))
    assert work(copy) == ["estimate-1", "refinement-2", "estimate-2", "training"]


def test_a_resumed_run_repeats_the_warnings_of_finished_stages(
    quick_start, capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = [image * np.float32(1.6 if index == 2 else 1.0) for index, image in enumerate(capture.images)]
    run = write_run(tmp_path / "run", replace(capture, images=images), **BASE)

    def stop(*arguments: Any) -> None:
        raise FiptError("disk-full", "The disk is full.", "Free some space.")

    with monkeypatch.context() as patch:
        patch.setattr(material_stages, "pretrain", stop)
        with pytest.raises(FiptError):
            run_here(run)
    for done in (["training"], []):
        messages = run_here(run)
        assert [message["name"] for message in messages if message["type"] == "stage"] == done
        (warning,) = [message for message in messages if message["type"] == "warning"]
        assert warning["code"] == "view-exposure" and "train/002" in warning["text"] and warning["remedy"]


def test_stages_that_take_no_time_have_no_rate(
    quick_start, capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clocks may tick only every 16 ms."""
    monkeypatch.setattr(stages, "time", SimpleNamespace(monotonic=lambda: 7.0))
    run = write_run(tmp_path / "run", capture, **BASE)
    run_here(run)
    listed = read_json(run.statistics_json)["stages"]
    assert [stage["seconds"] for stage in listed] == [0.0] * 4
    assert listed[1]["rays"] > 0 and "mrays_per_second" not in listed[1]
