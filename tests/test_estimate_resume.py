# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Changed settings keep the stages that do not read them, and a resumed run equals a new one."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fipt_blender.core.estimate import training_stages
from fipt_blender.core.run import chain
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.small_captures import QUICK, UNTRAINED, panel_capture, run_here, write_run

# Small enough to be quick, and such that each setting has an effect.
BASE = {**QUICK, **UNTRAINED, "batch_size": 512, "rounds": 0}
ALL = [
    *("pixels", "checks", "unmixing", "outside", "shadings", "estimate-0"),
    *("reflection-1", "refinement-1", "estimate-1", "training"),
]


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def capture():
    return panel_capture()


def work(run: RunFolder) -> list[str]:
    """Run the estimation; returns the stages that were done."""
    return [message["name"] for message in run_here(run, train=False) if message["type"] == "stage"]


@pytest.fixture(scope="module")
def fresh(capture, tmp_path_factory: pytest.TempPathFactory):
    """Makes run folders of complete estimations with some settings."""
    made: dict[str, RunFolder] = {}

    def make(**changes: Any) -> RunFolder:
        key = json.dumps(changes, sort_keys=True)
        if key not in made:
            root = tmp_path_factory.mktemp("run") / "run"
            made[key] = write_run(root, capture, **{**BASE, **changes})
            work(made[key])
        return made[key]

    return make


def outcome(run: RunFolder) -> dict[str, bytes]:
    """The results, bit for bit."""
    with np.load(run.fields_npz, allow_pickle=False) as data:
        found = {name: data[name].tobytes() for name in data.files}
    return found | {"emitters": run.emitters_json.read_bytes()}


@pytest.mark.parametrize(
    ("before", "changes", "done"),
    [
        (0, {"lambda_diffuse": 1e-3}, ["training"]),
        (0, {"view_error": 1e-2}, ["estimate-0", "training"]),
        (0, {"diffuse_spp": 17}, ["shadings", "estimate-0", "training"]),
        (0, {"unmix": False}, ["unmixing", *ALL[3:6], "training"]),
        (1, {"rounds": 0}, ["shadings", "training"]),  # the refinement replaced the shadings of stage 1
        (1, {"rounds": 1, "refine_diffuse_spp": 17}, ALL[7:]),
        (1, {"rounds": 1, "shrink_detail": False}, []),
        (1, {"rounds": 1, "checkpoint_steps": 7}, []),
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
    assert outcome(copy) == outcome(fresh(**changes))


@pytest.mark.parametrize("name", ALL)
def test_damaged_outputs_of_a_stage_are_made_again(fresh, tmp_path: Path, name: str) -> None:
    run = RunFolder(shutil.copytree(fresh(rounds=1).root, tmp_path / "run"))
    for path in [*(run.stage / name).rglob("*.npy"), *(run.stage / name).glob("outputs.json")]:
        path.write_bytes(path.read_bytes()[:20])
    (run.stage / "training" / "outputs.json").unlink()
    messages = run_here(run, train=False)
    done = [message["name"] for message in messages if message["type"] == "stage"]
    codes = [message["code"] for message in messages if message["type"] == "warning"]
    # What no later stage and no result needs is not read.
    assert name in done or name in ("shadings", "estimate-0", "reflection-1")
    assert "training" in done and codes.count("checkpoint-damaged") == len(done)
    assert outcome(run) == outcome(fresh(rounds=1))
    assert work(run) == []


def test_a_damaged_checkpoint_of_an_unfinished_training_is_discarded(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh().root, tmp_path / "run"))
    path = run.stage / "stages.json"
    data = json.loads(path.read_text())
    del data["stages"]["training"]
    path.write_text(json.dumps(data))
    (run.stage / "training" / "unfinished.pt").write_bytes(b"cut off")
    messages = run_here(run, train=False)
    assert [message["name"] for message in messages if message["type"] == "stage"] == ["training"]
    assert "checkpoint-damaged" in [message.get("code") for message in messages]
    assert outcome(run) == outcome(fresh())


def test_a_resumed_run_repeats_the_warnings_of_finished_stages(
    capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = [image * np.float32(1.6 if index == 2 else 1.0) for index, image in enumerate(capture.images)]
    run = write_run(tmp_path / "run", replace(capture, images=images), **BASE)

    def stop(*arguments: Any) -> None:
        raise FiptError("disk-full", "The disk is full.", "Free some space.")

    with monkeypatch.context() as patch:
        patch.setattr(training_stages, "pretrain", stop)
        with pytest.raises(FiptError):
            run_here(run, train=False)
    for done in (["training"], []):
        messages = run_here(run, train=False)
        assert [message["name"] for message in messages if message["type"] == "stage"] == done
        (warning,) = [message for message in messages if message["type"] == "warning"]
        assert warning["code"] == "view-exposure" and "train/002" in warning["text"] and warning["remedy"]


def test_stages_that_take_no_time_have_no_rate(capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks may tick only every 16 ms."""
    monkeypatch.setattr(chain, "time", SimpleNamespace(monotonic=lambda: 7.0))
    run = write_run(tmp_path / "run", capture, **BASE)
    run_here(run, train=False)
    listed = read_document(run.statistics_json, dict)["stages"]
    assert [stage["seconds"] for stage in listed] == [0.0] * 7
    assert listed[4]["rays"] > 0 and "mrays_per_second" not in listed[4]


def test_a_changed_photograph_that_was_held_back_is_judged_again(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh(rounds=0).root, tmp_path / "run"))
    data = json.loads(run.capture_json.read_text())
    data["views"][1]["split"] = "held_back"
    run.capture_json.write_text(json.dumps(data))
    assert work(run)[-1] == "quality" and work(run) == []
    image = run.resolve(data["views"][1]["image"])
    os.utime(image, (0, 0))
    assert work(run) == ["quality"]
