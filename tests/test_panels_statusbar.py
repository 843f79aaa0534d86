# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The running job in the status bar, and the notice at its end. A window is needed to see them: tests/gui."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from fipt_blender.bridge.sequence import own_job
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.errors import FiptError
from fipt_blender.jobs import running, window
from fipt_blender.panels import statusbar

pytestmark = pytest.mark.usefixtures("registered")


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
