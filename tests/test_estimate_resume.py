# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Changed settings keep the stages that do not read them, and a resumed run equals a new one."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fipt_blender.core.run import chain
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples.small_captures import QUICK, UNTRAINED, outcome, panel_capture, run_here, stages_of, warnings_of, write_run

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
    return stages_of(run_here(run, train=False))


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


@pytest.mark.parametrize(
    ("before", "changes", "done"),
    [
        (0, {"unmix": False}, ["unmixing", *ALL[3:6], "training"]),
        (1, {"rounds": 0}, ["shadings", "training"]),  # the refinement replaced the shadings of stage 1
        (1, {"rounds": 1, "refine_diffuse_spp": 17}, ALL[7:]),
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
    assert outcome(copy) == outcome(fresh(**changes))


@pytest.mark.parametrize("name", ["pixels", "refinement-1", None], ids=str)
def test_damaged_outputs_of_a_stage_are_made_again(fresh, tmp_path: Path, name: str | None) -> None:
    """Of one stage, or of all."""
    run = RunFolder(shutil.copytree(fresh(rounds=1).root, tmp_path / "run"))
    for folder in [run.stage / name] if name else [path for path in run.stage.iterdir() if path.is_dir()]:
        for path in [*folder.rglob("*.npy"), *folder.glob("outputs.json")]:
            path.write_bytes(path.read_bytes()[:20])
    (run.stage / "training" / "outputs.json").unlink(missing_ok=True)
    messages = run_here(run, train=False)
    done = stages_of(messages)
    # What no later stage and no result needs is not read.
    assert {name or "pixels", "training"} <= set(done)
    # Where all are damaged, a stage may begin before that of its inputs is noticed.
    damaged = warnings_of(messages).count("checkpoint-damaged")
    assert damaged == len(done) if name else 0 < damaged <= len(ALL)
    assert outcome(run) == outcome(fresh(rounds=1))
    assert work(run) == []


def test_a_damaged_checkpoint_of_an_unfinished_training_is_discarded(fresh, tmp_path: Path) -> None:
    run = RunFolder(shutil.copytree(fresh(rounds=0).root, tmp_path / "run"))
    path = run.stage / "stages.json"
    data = json.loads(path.read_text())
    del data["stages"]["training"]
    path.write_text(json.dumps(data))
    (run.stage / "training" / "unfinished.pt").write_bytes(b"cut off")
    messages = run_here(run, train=False)
    assert stages_of(messages) == ["training"] and "checkpoint-damaged" in warnings_of(messages)
    assert outcome(run) == outcome(fresh(rounds=0))


def test_stages_that_take_no_time_have_no_rate(fresh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks may tick only every 16 ms."""
    monkeypatch.setattr(chain, "time", SimpleNamespace(monotonic=lambda: 7.0))
    run = RunFolder(shutil.copytree(fresh(rounds=0).root, tmp_path / "run"))
    run.create(make_settings("draft", {**BASE, "diffuse_spp": 17}))
    assert work(run) == ["shadings", "estimate-0", "training"]
    listed = read_document(run.statistics_json, dict)["stages"]
    assert [stage["seconds"] for stage in listed[4:]] == [0.0] * 3
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
