"""A job as a sequence of steps: order, slices of work, cancelling, what is told of it."""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from fipt_blender.bridge import job as jobs
from fipt_blender.bridge.job import SLICE_SECONDS, Job
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.step import Step
from fipt_blender.core.run.contents import JobNote
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError

DONE = 'print(json.dumps({"type": "done", "files": ["a"], "data": {"x": 1}}), flush=True)\n'


def test_steps_run_in_order_and_the_job_tells_of_them(tmp_path):
    ran = []
    warning = {"type": "warning", "code": "c", "text": "t", "remedy": "r"}

    def start(name):
        ran.append(name)
        return EngineProcess([sys.executable, "-c", f"import json\n{DONE}"], tmp_path / "log.txt")

    steps = [
        Step("a", "A", 1.0, process=partial(start, "a")),
        Step("b", "B", 1.0, function=lambda: ran.append("b") or [warning]),
        Step("c", "C", 4.0, process=partial(start, "c")),
    ]
    messages: list[dict] = []
    job = Job(steps, tmp_path / "log.txt", lambda: (["result"], {}), tmp_path / "job.json")
    assert job.run(messages.append) and job.state == "finished" and job.data == {"x": 1}
    assert ran == ["a", "b", "c"] == [m["name"] for m in messages if m["type"] == "stage"]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0
    assert messages[-1] == {"type": "done", "files": ["result"], "data": {}}
    note = read_document(tmp_path / "job.json", JobNote)
    assert list(note.seconds) == ran and [each.code for each in note.warnings] == ["c"]


def test_an_engine_that_dies_ends_the_job(tmp_path):
    ran = []
    command = [sys.executable, "-c", "raise SystemExit(9)"]
    steps = [
        Step("a", "A", 1.0, process=lambda: EngineProcess(command, tmp_path / "log.txt")),
        Step("b", "B", 1.0, function=lambda: ran.append("b")),
    ]
    job = Job(steps, tmp_path / "log.txt")
    assert not job.run() and job.state == "failed" and job.error["code"] == "engine-crashed" and not ran


def slice_job(tmp_path: Path, function) -> Job:
    return Job([Step("x", "Doing x", 1.0, function=function)], tmp_path / "log.txt")


def test_a_function_may_work_in_slices(tmp_path):
    warning = {"type": "warning", "code": "c", "text": "t", "remedy": "r"}
    ran = []

    def function():
        for index in range(30):
            time.sleep(0.01)
            ran.append(index)
            yield index / 30
        return [warning]

    job = slice_job(tmp_path, function)
    job.advance()  # announces it
    assert not ran
    counts, messages = [], []
    while not job.ended:
        before = len(ran)
        messages += job.advance()
        counts.append(len(ran) - before)
    assert ran == list(range(30)) and max(counts) <= 6  # about 50 ms a call
    fractions = [message["stage_fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions) and len(fractions) >= 5
    assert warning in messages and messages[-1]["type"] == "done"
    ran.clear()
    assert slice_job(tmp_path, function).run(lambda message: None) and len(ran) == 30


def test_slices_that_fail_or_are_cancelled_are_closed(tmp_path):
    closed = []

    def function(error=None):
        try:
            yield
            if error is not None:
                raise error
            time.sleep(SLICE_SECONDS)
            yield
            yield
        finally:
            closed.append(True)

    for error, code in ((FiptError.of("mesh-empty", "E.", "F."), "mesh-empty"), (KeyError(), "blender-step-failed")):
        job = slice_job(tmp_path, lambda error=error: function(error))
        assert not job.run(lambda message: None) and job.error["code"] == code
    job = slice_job(tmp_path, function)
    for _ in range(3):
        job.advance()
    assert len(closed) == 2 and not job.ended
    job.request_cancel()
    assert len(closed) == 3 and job.ended and job.cancelled and job.error is None


def test_a_quiet_engine_is_told_of_and_less_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "QUIET_SECONDS", 0.0)
    told = {"type": "progress", "fraction": 0.25, "remaining_seconds": 1000.0}
    script = f"import pathlib, time\nprint({json.dumps(told)!r}, flush=True)\n"
    script += f"while not pathlib.Path({str(tmp_path / 'go')!r}).exists(): time.sleep(0.01)\nimport json\n{DONE}"
    step = Step("a", "A", 4000.0, process=lambda: EngineProcess([sys.executable, "-c", script], tmp_path / "log.txt"))
    messages: list[dict] = []

    def note(message):
        if message["type"] == "progress" and message["stage_fraction"] == 0.25:
            messages.append(message)
        if len(messages) == 4:
            (tmp_path / "go").touch()

    assert Job([step], tmp_path / "log.txt").run(note)
    left = [message["remaining_seconds"] for message in messages]
    assert len(left) >= 4 and left == sorted(left, reverse=True) and left[0] <= 1000.0


def test_what_steps_find_changes_the_time_that_later_ones_are_expected_to_take(tmp_path):
    found: list[float] = []
    steps = [
        Step("a", "A", 10.0, function=lambda: found.append(970.0)),
        Step("b", "B", 1.0, function=lambda: None, expected=lambda: found[0] if found else None),
        Step("c", "C", 20.0, function=lambda: None),
    ]
    messages: list[dict] = []
    Job(steps, tmp_path / "log.txt").run(messages.append)
    told = [message for message in messages if message["type"] == "progress"]
    assert told[0]["remaining_seconds"] is None  # nothing is announced that is not known
    begins = [message for message in told if message["stage_fraction"] == 0.0]
    assert begins[1]["remaining_seconds"] == pytest.approx(990.0, abs=1.0)
