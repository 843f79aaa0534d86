# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How sections draw their jobs, on a stand-in of Blender's layout: the way on first, then warnings."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from fipt_blender.jobs import running, runstate
from fipt_blender.panels import estimate, materials
from samples.layouts import drawn_by

pytestmark = pytest.mark.usefixtures("registered")

WARNINGS = [
    {"code": code, "text": f"The {code} is odd.", "remedy": f"Mend the {code}."} for code in ("lamp", "wall")
]


def set_running(monkeypatch, kind: str, title: str, folder: Path) -> running.RunningJob:
    """Let a job of a kind run."""
    job = running.RunningJob(title, kind, bpy.context.scene.name, folder, fraction=0.42)
    monkeypatch.setattr(running, "current", lambda: job)
    return job


@pytest.fixture
def finished(monkeypatch, tmp_path) -> None:
    """An estimation with two warnings has ended in the scene's run folder."""
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    job = running.RunningJob("Estimate", "estimate", bpy.context.scene.name, tmp_path, state="finished")
    job.warnings += WARNINGS
    monkeypatch.setattr(running, "last", lambda kind: job if kind == "estimate" else None)
    monkeypatch.setattr(
        runstate, "known", lambda folder: runstate.RunState(stages=5, results=True, finished=True)
    )


@pytest.mark.usefixtures("finished")
def test_after_an_estimation_the_way_on_comes_before_its_warnings():
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn[-3:] == ["Finished", "fipt.apply_results", "2 warnings"]


def test_results_of_the_estimate_before_can_be_applied_while_a_new_one_is_stopped(monkeypatch, tmp_path):
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    monkeypatch.setattr(runstate, "known", lambda folder: runstate.RunState(stages=2, results=True))
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert {"fipt.resume", "fipt.apply_results"} <= set(drawn) and "Finished" not in drawn


@pytest.mark.usefixtures("finished")
def test_opened_warnings_show_what_helps():
    drawn = drawn_by(estimate.FIPT_PT_estimate, is_open=True)[0]
    told = ["The lamp is odd.", "Mend the lamp.", "The wall is odd.", "Mend the wall."]
    assert drawn[-5:] == ["2 warnings", *told]


def test_warnings_of_an_estimation_that_another_blender_has_run(monkeypatch, tmp_path):
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    state = runstate.RunState(stages=5, results=True, finished=True, warnings=tuple(WARNINGS[:1]))
    monkeypatch.setattr(runstate, "known", lambda folder: state)
    monkeypatch.setattr(running, "last", lambda kind: None)
    assert drawn_by(estimate.FIPT_PT_estimate)[0][-1] == "1 warning"


@pytest.mark.usefixtures("finished")
def test_while_an_estimation_runs_only_its_own_warnings_are_counted(monkeypatch, tmp_path):
    job = set_running(monkeypatch, "estimate", "Estimate", tmp_path)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert "42%" in drawn and "fipt.estimate" not in drawn and "2 warnings" not in drawn
    job.warnings += WARNINGS
    assert drawn_by(estimate.FIPT_PT_estimate)[0][-1] == "2 warnings"


def test_estimate_says_for_what_it_waits_and_how_to_stop_that(monkeypatch, tmp_path):
    set_running(monkeypatch, "survey", "Check Views", tmp_path)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn.index("fipt.estimate") < drawn.index("Check Views: 42%") < drawn.index("fipt.cancel")
    with pytest.raises(RuntimeError, match=r"Check Views is running\. Wait for its end, or stop it with Esc"):
        bpy.ops.fipt.estimate()


@pytest.mark.parametrize("applied", [False, True])
def test_warnings_of_apply_results_come_last(monkeypatch, tmp_path, applied):
    scene = bpy.context.scene
    scene.fipt.run_folder = str(tmp_path)
    scene.fipt.materials.object_count = int(applied)
    job = running.RunningJob("Apply Results", "materials", scene.name, tmp_path, state="finished")
    job.warnings += WARNINGS
    monkeypatch.setattr(running, "last", lambda kind: job if kind == "materials" else None)
    drawn = drawn_by(materials.FIPT_PT_materials)[0]
    assert drawn[-1] == "2 warnings" and ("fipt.revert" in drawn) is applied


def test_the_resolution_of_light_and_the_cost_are_told_before_the_start():
    settings = bpy.context.scene.fipt
    settings.capture.train_count, settings.capture.megapixels = 60, 12.2
    settings.estimate.preset = "draft"
    text = " ".join(drawn_by(estimate.FIPT_PT_estimate)[0])
    assert "60 photographs of 12.2 megapixels" in text and "light is solved at" in text
    assert "About" in text and "minutes" in text and "GB" in text
    settings.capture.train_count = 0
    assert "megapixels" not in " ".join(drawn_by(estimate.FIPT_PT_estimate)[0])
