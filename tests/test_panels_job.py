# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How sections draw their jobs, on a stand-in of Blender's layout: the way on first, then warnings."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from fipt_blender.bridge.sequence import own_job
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running, runstate, window
from fipt_blender.panels import estimate, statusbar
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


def test_a_result_says_how_good_it_is(monkeypatch, tmp_path):
    figures = {"held_back_db": 27.14, "projection_db": 29.4, "causes": [], "views": []}
    write_json(tmp_path / "results" / "quality.json", figures)
    state = runstate.RunState(results=True, finished=True, quality=runstate.look(RunFolder(tmp_path)).quality)
    bpy.context.scene.fipt.run_folder = str(tmp_path)
    monkeypatch.setattr(runstate, "known", lambda folder: state)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert "Held-back photographs: 27.1 dB (projection 29.4)" in drawn


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
    assert "Estimate: 42%" in drawn and "fipt.estimate" not in drawn and "2 warnings" not in drawn
    job.warnings += WARNINGS
    assert drawn_by(estimate.FIPT_PT_estimate)[0][-1] == "2 warnings"


def test_estimate_says_for_what_it_waits_and_how_to_stop_that(monkeypatch, tmp_path):
    set_running(monkeypatch, "survey", "Check Views", tmp_path)
    drawn = drawn_by(estimate.FIPT_PT_estimate)[0]
    assert drawn.index("fipt.estimate") < drawn.index("Check Views: 42%") < drawn.index("fipt.cancel")
    with pytest.raises(RuntimeError, match=r"Check Views is running\. Wait for its end, or stop it with Esc"):
        bpy.ops.fipt.estimate()


def test_the_resolution_of_light_and_the_cost_are_told_before_the_start():
    settings = bpy.context.scene.fipt
    settings.capture.train_count, settings.capture.megapixels = 60, 12.2
    settings.estimate.preset = "draft"
    text = " ".join(drawn_by(estimate.FIPT_PT_estimate)[0])
    assert "60 photographs of 12.2 megapixels" in text and "light is solved at" in text
    assert "About" in text and "minutes" in text and "GB" in text
    settings.capture.train_count = 0
    assert "megapixels" not in " ".join(drawn_by(estimate.FIPT_PT_estimate)[0])


@pytest.fixture
def notices(monkeypatch) -> list[tuple[str, str]]:
    """The notices that jobs show."""
    shown: list[tuple[str, str]] = []
    monkeypatch.setattr(running, "show_notice", lambda text, level: shown.append((text, level)))
    return shown


def do_job(tmp_path: Path, function) -> running.RunningJob:
    """Run a job of one function to its end."""
    job = own_job([Step("one", "One", 1.0, function=function)], tmp_path / "steps.json", tmp_path / "log.txt")
    return running.run(job, running.RunningJob("Check Views", "views", "", tmp_path))


def test_a_job_in_a_few_words():
    job = running.RunningJob("Estimate", "estimate", "", Path())
    assert statusbar.status_text(job) == "Estimate: 0%"
    job.fraction, job.remaining_seconds = 0.42, 181.0
    assert statusbar.status_text(job) == "Estimate: 42%, 3 min left"
    job.stopping = True
    assert statusbar.status_text(job) == "Estimate: stopping..."


def test_the_end_is_told(tmp_path, notices):
    assert do_job(tmp_path, lambda: None).state == "finished"
    assert notices == [("Check Views: finished", "INFO")]


def test_a_failure_is_told_with_its_reason(tmp_path, notices):
    def fail():
        raise FiptError("odd", "There is no mesh.", "Import one.")

    assert do_job(tmp_path, fail).state == "failed"
    assert notices == [("Check Views failed: There is no mesh.", "ERROR")]


def test_who_cancels_is_told_nothing(tmp_path, notices):
    def wait():
        while True:
            yield 0.0

    job = own_job([Step("one", "One", 1.0, function=wait)], tmp_path / "steps.json", tmp_path / "log.txt")
    info = running.start(job, running.RunningJob("Check Views", "views", "", tmp_path))
    running.tick()
    running.cancel()
    running.tick()
    assert info.state == "cancelled" and notices == []


def test_a_notice_reports():
    with pytest.raises(RuntimeError, match="no mesh"):
        bpy.ops.fipt.notice(text="There is no mesh.", level="ERROR")
    assert bpy.ops.fipt.notice(text="Finished", level="INFO") == {"FINISHED"}


def test_the_status_bar_waits_while_a_tool_shows_its_keys(monkeypatch):
    cleared = []
    workspace = SimpleNamespace(status_text_set_internal=cleared.append)
    screen = SimpleNamespace(areas=[])
    windows = [
        SimpleNamespace(modal_operators=tools, workspace=workspace, screen=screen) for tools in ([1], [])
    ]
    context = SimpleNamespace(window_manager=SimpleNamespace(windows=windows))
    monkeypatch.setattr(
        window, "bpy", SimpleNamespace(context=context, app=SimpleNamespace(background=False))
    )
    window.redraw()
    assert cleared == [None]
