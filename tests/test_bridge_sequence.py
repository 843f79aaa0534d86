# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A job as a sequence of steps: order, resuming, slices of work, cancelling, the record of steps."""

from __future__ import annotations

import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from fipt_blender.bridge import sequence
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.sequence import SLICE_SECONDS, Job
from fipt_blender.bridge.step import Step, StepRecord, chain_keys
from fipt_blender.core.run.errors import FiptError

DONE = 'print(json.dumps({"type": "done", "files": ["a"], "data": {}}), flush=True)\n'


class Steps:
    """A job with engine commands and functions; records which of them ran."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ran: list[str] = []
        self.engine = "import json, pathlib, sys; pathlib.Path(sys.argv[1]).touch()\n" + DONE

    def start(self, path):
        self.ran.append(path.name)
        return EngineProcess([sys.executable, "-c", self.engine, str(path)], self.folder / "log.txt")

    def note(self, name):
        return lambda: self.ran.append(name)

    def job(self, own_file: bool = True, **inputs) -> Job:
        a, b, d = (self.folder / name for name in ("a", "b", "d"))
        of_a, of_b, of_d = ({"x": inputs.get(name)} for name in ("a", "b", "d"))
        steps = [
            Step("a", "A", 1.0, inputs=of_a, process=partial(self.start, a), outputs=[a]),
            Step("scene", "Scene", 1.0, function=self.note("scene"), repeat=True),
            Step("b", "B", 1.0, inputs=of_b, process=partial(self.start, b), outputs=[b], reset=self.note("reset b")),
            Step("save", "Save", 1.0, function=self.note("save"), restore=self.note("restore") if own_file else None),
            Step("d", "D", 4.0, inputs=of_d, process=partial(self.start, d), outputs=[d]),
        ]
        record = StepRecord(self.folder / "steps.json")
        return Job(steps, self.folder / "log.txt", record, lambda: (["result"], {}), resume=True)

    def run(self, **changed) -> list[dict]:
        self.ran.clear()
        messages: list[dict] = []
        self.job(**changed).run(messages.append)
        return messages


def test_steps_run_in_order_and_again_from_the_first_with_changed_inputs_or_lost_outputs(tmp_path):
    steps = Steps(tmp_path)
    messages = steps.run()
    assert steps.ran == ["a", "scene", "reset b", "b", "save", "d"]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0
    assert messages[-1] == {"type": "done", "files": ["result"], "data": {}}
    assert [m["name"] for m in messages if m["type"] == "stage"] == ["a", "scene", "b", "save", "d"]
    steps.run(b=1)
    assert steps.ran == ["scene", "reset b", "b", "save", "d"]
    steps.run(b=1, d=1)
    assert steps.ran == ["restore", "d"]
    steps.run(b=1, own_file=False)  # a scene that may not be replaced is built again instead
    assert steps.ran == ["scene", "d"]
    (tmp_path / "b").unlink()
    steps.run(b=1)
    assert steps.ran == ["scene", "b", "save", "d"]
    steps.run(a=1, b=1)
    assert steps.ran == ["a", "scene", "reset b", "b", "save", "d"]


def test_a_step_that_was_interrupted_keeps_its_checkpoints(tmp_path):
    steps = Steps(tmp_path)
    good = steps.engine
    steps.engine = "import pathlib, sys; sys.exit(0 if pathlib.Path(sys.argv[1]).touch() else 9)"
    messages = steps.run()
    assert messages[-1]["code"] == "engine-crashed" and steps.ran == ["a"]
    steps.engine = f"import sys; sys.argv[1].endswith('b') and sys.exit(7)\n{good}"
    assert steps.run()[-1]["type"] == "error" and steps.ran == ["a", "scene", "reset b", "b"]
    steps.engine = good
    steps.run()
    assert steps.ran == ["scene", "b", "save", "d"]


def make_job(folder: Path, *steps: Step, resume: bool = True) -> Job:
    """Of functions alone."""
    record = StepRecord(folder / "steps.json")
    return Job(steps, folder / "log.txt", record, resume=resume)


def slice_job(tmp_path: Path, function) -> Job:
    return make_job(tmp_path, Step("x", "Doing x", 1.0, function=function), resume=False)


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
    while not job.finished:
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

    for error, code in ((FiptError("mesh-empty", "E.", "F."), "mesh-empty"), (KeyError(), "blender-step-failed")):
        job = slice_job(tmp_path, lambda error=error: function(error))
        assert not job.run(lambda message: None) and job.error["code"] == code
    job = slice_job(tmp_path, function)
    for _ in range(3):
        job.advance()
    assert len(closed) == 2 and not job.finished
    job.request_cancel()
    assert len(closed) == 3 and job.finished and job.cancelled and job.error is None


def test_two_records_of_one_file_keep_what_the_other_has_stored(tmp_path):
    path = tmp_path / "steps.json"
    StepRecord(path).store("old", "key", finished=True)
    first, second = StepRecord(path), StepRecord(path)
    first.store("a", "1", finished=True)
    second.forget(["old"])
    second.store("b", "2", finished=False)
    first.store("a", "3", finished=True)
    read = StepRecord(path)
    assert [read.key(name) for name in ("old", "a", "b")] == [None, "3", "2"]
    path.write_text("{")  # damaged while both are at work
    second.store("b", "4", finished=True)
    read = StepRecord(path)
    assert not read.problem and [read.key(name) for name in ("a", "b")] == ["1", "4"]


def test_records_that_store_at_the_same_time_lose_nothing(tmp_path):
    names = [[f"{writer}-{step}" for step in range(15)] for writer in range(4)]

    def store(own):
        record = StepRecord(tmp_path / "steps.json")
        for name in own:
            record.store(name, "key", finished=True)

    with ThreadPoolExecutor(len(names)) as pool:
        list(pool.map(store, names))
    read = StepRecord(tmp_path / "steps.json")
    assert [name for own in names for name in own if read.key(name) != "key"] == []


def test_a_resumed_job_repeats_the_warnings_of_finished_steps(tmp_path):
    def warn(code):
        return {"type": "warning", "code": code, "text": "t", "remedy": "r"}

    def run(last):
        steps = [
            Step("a", "A", 1.0, function=lambda: [warn("a")]),
            Step("again", "Again", 1.0, function=lambda: [warn("again")], repeat=True),
            Step("saved", "S", 1.0, function=lambda: [warn("saved")], restore=lambda: None),
            Step("b", "B", 1.0, inputs={"x": last}, function=lambda: [warn("b")]),
        ]
        messages = []
        make_job(tmp_path, *steps).run(messages.append)
        codes = [message["code"] for message in messages if message["type"] == "warning"]
        data = json.loads((tmp_path / "steps.json").read_text())["steps"]
        return codes, [warning["code"] for step in data.values() for warning in step["warnings"]]

    first = run(1)
    assert first == (["a", "again", "saved", "b"],) * 2
    assert run(1) == first, "nothing is left to do"
    assert run(2) == first, "only the last step is done again"


@pytest.mark.parametrize(
    "content",
    [
        *("", "[]", "{}", '{"version": 1, "steps": [1]}', '{"version": 1, "steps": {"a": {"key": 1}}}'),
        '{"version": 1, "steps": {"a": {"key": "k", "finished": true, "warnings": 5}}}',
        '{"version": 1, "steps": {"a": {"key": "k", "finished": true, "warnings": [{"type": "warning"}]}}}',
    ],
)
def test_a_damaged_record_of_steps_is_discarded_with_a_warning(tmp_path, content):
    path = tmp_path / "steps.json"
    path.write_text(content)
    step = Step("a", "A", 1.0, function=lambda: None)
    messages = []
    assert make_job(tmp_path, step).run(messages.append)
    assert [message.get("code") for message in messages if message["type"] == "warning"] == ["steps-damaged"]
    assert StepRecord(path).problem == "" and StepRecord(path).finished(step, chain_keys([step])[0])


def test_a_quiet_engine_is_told_of_and_less_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr(sequence, "QUIET_SECONDS", 0.0)
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

    assert make_job(tmp_path, step).run(note)
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
    make_job(tmp_path, *steps).run(messages.append)
    told = [message for message in messages if message["type"] == "progress"]
    assert told[0]["remaining_seconds"] is None  # nothing is announced that is not known
    begins = [message for message in told if message["stage_fraction"] == 0.0]
    assert begins[1]["remaining_seconds"] == pytest.approx(990.0, abs=1.0)
