# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other settings keep the stages that do not read them: each names its stage, and resumed equals fresh."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_captures import QUICK, panel_capture, run_here, write_run

from fipt_blender.core.job import stages
from fipt_blender.core.job.runfolder import RunFolder
from fipt_blender.core.job.settings import (
    LATER_TRAINING,
    REFINEMENT,
    SHADINGS,
    TRAINING,
    Settings,
    make_settings,
)
from fipt_blender.core.material import training

# Small enough to be quick, and such that each setting has an effect.
BASE = {**QUICK, "training_steps": 6, "later_training_steps": 4, "batch_size": 512, "rounds": 0}
# Values other than those of BASE where doubling is no legal change.
OTHERS = {
    "masking": "smith",
    "emission": "joint",
    "atlas_mode": "color_attribute",
    "write_back": "paper",
    "preset": "medium",
}


def changes(stage: str | None) -> dict[str, Any]:
    """Another value for each setting that a stage is the first to read."""
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
    """Few steps towards the guess as well: here it matters that results are alike, not that they are good."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (training, stages):
            patch.setattr(module, "PRETRAINING_STEPS", 4)
        yield


@pytest.fixture(scope="module")
def capture():
    return panel_capture()


def work(run: RunFolder) -> list[str]:
    """Estimate; returns the stages that were done."""
    return [message["name"] for message in run_here(run) if message["type"] == "stage"]


@pytest.fixture(scope="module")
def fresh(quick_start, capture, tmp_path_factory: pytest.TempPathFactory):
    """Run folders of whole estimations by their rounds and by the stage whose settings are changed."""
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
    """A copy of a finished run gone on with other settings, and the stages that it did."""
    copy = RunFolder(shutil.copytree(run.root, folder))  # keeps the times of the photographs
    copy.create(make_settings("draft", {**BASE, "rounds": rounds, **changes(stage)}))
    return copy, work(copy)


def arrays(folder: Path) -> dict[str, bytes]:
    """What each file of a folder holds."""
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.npy"))}


def weights(run: RunFolder, index: int) -> dict[str, bytes]:
    """The networks and the emitters after a training."""
    state = torch.load(run.stage / f"networks-{index}.pt", weights_only=True)
    tensors = {**state["brdf"], **state["emission"], "emitting": state["emitting"]}
    return {name: value.numpy().tobytes() for name, value in tensors.items()}


def outcome(run: RunFolder) -> dict[str, bytes]:
    """The results, bit for bit."""
    with np.load(run.fields_npz, allow_pickle=False) as data:
        found = {name: data[name].tobytes() for name in data.files}
    return found | {"emitters": run.emitters_json.read_bytes()}


def test_stages_depend_on_no_setting_that_is_said_to_be_read_later(fresh) -> None:
    """All settings of a stage changed at once leave what was finished before it as it is."""
    none, one = fresh(0), fresh(1)
    assert arrays(fresh(0, SHADINGS).stage / "pixels") == arrays(none.stage / "pixels")
    other = fresh(0, TRAINING)
    assert arrays(other.stage / "pixels") == arrays(none.stage / "pixels")
    assert arrays(other.stage / "shadings") == arrays(none.stage / "shadings")
    assert weights(other, 0) != weights(none, 0)
    assert weights(none, 0) == weights(one, 0), "the number of rounds changes none of them"
    refinement = fresh(1, REFINEMENT)
    assert weights(refinement, 0) == weights(one, 0)
    assert arrays(refinement.stage / "shadings") != arrays(one.stage / "shadings")
    later = fresh(1, LATER_TRAINING)
    assert weights(later, 0) == weights(one, 0)
    assert arrays(later.stage / "shadings") == arrays(one.stage / "shadings")
    assert weights(later, 1) != weights(one, 1)
    assert outcome(fresh(1, None)) == outcome(one)


@pytest.mark.parametrize(
    ("rounds_before", "rounds", "stage", "done"),
    [
        (0, 0, TRAINING, ["training-0"]),
        (0, 0, SHADINGS, ["shadings", "training-0"]),
        (1, 0, TRAINING, ["shadings", "training-0"]),  # the refinement wrote over stage 1's shadings
        (1, 1, REFINEMENT, ["refinement-1", "training-1"]),
        (1, 1, LATER_TRAINING, ["training-1"]),
        (1, 1, None, []),
    ],
)
def test_resumed_under_other_settings_equals_fresh(
    fresh, tmp_path: Path, rounds_before: int, rounds: int, stage: str | None, done: list[str]
) -> None:
    run, worked = resumed(fresh(rounds_before), tmp_path / "run", rounds, stage)
    assert worked == done
    assert outcome(run) == outcome(fresh(rounds, stage))


def test_another_number_of_rounds_keeps_those_that_are_done(fresh, tmp_path: Path) -> None:
    copy = RunFolder(shutil.copytree(fresh(1).root, tmp_path / "run"))
    copy.create(make_settings("draft", BASE))
    assert work(copy) == ["shadings", "training-0"], "the refinement wrote over stage 1's shadings"
    assert outcome(copy) == outcome(fresh(0))
    copy.create(make_settings("draft", {**BASE, "rounds": 1}))
    assert work(copy) == ["refinement-1", "training-1"] and outcome(copy) == outcome(fresh(1))
