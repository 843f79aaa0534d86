# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's process and the sequence of steps, against small children that misbehave in one way each."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from fipt_blender.bridge.process import EngineProcess, explain_death
from fipt_blender.bridge.sequence import SLICE_SECONDS, Job
from fipt_blender.bridge.step import Step, StepRecord, chain_keys
from fipt_blender.core.job.errors import FiptError
from fipt_blender.core.job.messages import parse_message

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and process groups")


def child(tmp_path: Path, script: str) -> EngineProcess:
    return EngineProcess([sys.executable, "-c", script], tmp_path / "log.txt")


def collect(process: EngineProcess) -> list[dict]:
    messages: list[dict] = []
    process.run_blocking(messages.append)
    return messages


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rsplit(")", 1)[1].split()[0] != "Z"


DONE = 'print(json.dumps({"type": "done", "files": ["a"], "data": {}}), flush=True)\n'


def test_messages_arrive_and_stray_output_goes_to_the_log(tmp_path):
    script = (
        "import json, os, sys\n"
        'print("hello from a library")\n'
        'print("{not json}")\n'
        'print(json.dumps({"type": "unheard-of", "x": 1}))\n'
        'print(json.dumps({"type": "progress", "fraction": 0.5}), flush=True)\n'
        'os.write(1, b"\\xff\\xfe broken utf-8\\n")\n'
        'os.write(2, b"on stderr\\n")\n' + DONE
    )
    process = child(tmp_path, script)
    messages = collect(process)
    assert [message["type"] for message in messages] == ["progress", "done"]
    assert process.error is None and process.done["files"] == ["a"] and process.returncode == 0
    log = (tmp_path / "log.txt").read_bytes()
    for text in (b"hello from a library", b"{not json}", b"unheard-of", b"broken utf-8", b"on stderr"):
        assert text in log


def test_a_message_split_over_two_writes_is_one_message(tmp_path):
    script = (
        "import json, os, time\n"
        'os.write(1, b\'{"type": "progress", "fra\')\n'
        "time.sleep(0.3)\n"
        "os.write(1, b'ction\": 0.25}\\n')\n" + DONE
    )
    messages = collect(child(tmp_path, script))
    assert messages[0] == {"type": "progress", "fraction": 0.25}


def test_poll_never_waits_and_much_output_is_read_whole(tmp_path):
    script = (
        "import json, pathlib, sys, time\n"
        'for i in range(20000): print(json.dumps({"type": "progress", "fraction": i / 20000}))\n'
        "sys.stdout.flush()\n"
        f"while not pathlib.Path({str(tmp_path / 'go')!r}).exists(): time.sleep(0.01)\n" + DONE
    )
    process = child(tmp_path, script)
    messages = process.poll()  # would it wait for the end, that would never come
    assert process.running
    (tmp_path / "go").touch()
    assert len(messages) + len(collect(process)) >= 20000


@posix
def test_a_crash_by_signal_is_named(tmp_path):
    process = child(
        tmp_path, "import os, signal; print('deep trouble', flush=True); os.kill(os.getpid(), signal.SIGSEGV)"
    )
    messages = collect(process)
    assert messages[-1]["type"] == "error" and messages[-1]["code"] == "engine-crashed"
    assert "SIGSEGV" in messages[-1]["text"] and "deep trouble" in messages[-1]["text"]
    assert messages[-1]["remedy"] and process.error == messages[-1]


@posix
def test_a_kill_from_outside_is_taken_for_lack_of_memory(tmp_path):
    process = child(tmp_path, "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    assert collect(process)[-1]["code"] == "out-of-memory"
    assert explain_death(137)["code"] == "out-of-memory"
    assert "SIGABRT" in explain_death(134)["text"]


def test_an_end_without_a_message_is_an_error_even_with_status_zero(tmp_path):
    assert collect(child(tmp_path, "pass"))[-1]["code"] == "engine-crashed"
    assert "exit status 3" in collect(child(tmp_path, "import sys; sys.exit(3)"))[-1]["text"]


def test_the_childs_own_error_is_not_covered_by_another(tmp_path):
    script = (
        "import json, sys\n"
        'print(json.dumps({"type": "error", "code": "mesh-empty", "text": "t", "remedy": "r"}))\n'
        "sys.exit(1)"
    )
    messages = collect(child(tmp_path, script))
    assert [message["code"] for message in messages] == ["mesh-empty"]


@posix
def test_cancel_ends_a_stubborn_child_and_its_children_within_two_seconds(tmp_path):
    script = (
        "import json, signal, subprocess, sys, time\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "inner = 'import json, os, signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)\\n'\n"
        'inner += \'print(json.dumps({"type": "stage", "name": str(os.getpid())}), flush=True)\\n\'\n'
        "grandchild = subprocess.Popen([sys.executable, '-c', inner + 'time.sleep(60)'])\n"
        "time.sleep(60)\n"
    )
    process = child(tmp_path, script)
    messages: list[dict] = []
    while not messages:
        messages = process.poll()
    grandchild = int(messages[0]["name"])
    assert is_alive(process.pid) and is_alive(grandchild)
    started = time.monotonic()
    process.cancel()
    assert time.monotonic() - started < 2.0
    assert not is_alive(process.pid)
    end = time.monotonic() + 10.0
    while is_alive(grandchild):  # killed, but the system may not have got to it
        assert time.monotonic() < end
        time.sleep(0.01)
    assert process.cancelled and not process.running and process.poll() == [] and process.error is None


@posix
def test_an_exception_in_the_receiver_leaves_no_orphan(tmp_path):
    process = child(
        tmp_path,
        'import json, time; print(json.dumps({"type": "stage"}), flush=True); time.sleep(60)',
    )

    def stop(message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        process.run_blocking(stop)
    assert not is_alive(process.pid)


@posix
def test_the_child_runs_in_a_group_of_its_own_and_nicely(tmp_path):
    expected = max(10, os.nice(0))  # a caller may be nicer still
    script = (
        "import json, os, time\nend = time.monotonic() + 10\n"
        f"while os.nice(0) < {expected} and time.monotonic() < end: time.sleep(0.01)\n"
        'data = {"group": os.getpgrp(), "nice": os.nice(0)}\n'
        'print(json.dumps({"type": "done", "files": [], "data": data}))'
    )
    process = child(tmp_path, script)
    data = collect(process)[-1]["data"]
    assert data["group"] == process.pid != os.getpgrp()
    assert data["nice"] == expected


def test_a_log_that_cannot_be_written_loses_no_message(tmp_path):
    command = [sys.executable, "-c", "import json; print('stray')\n" + DONE]
    process = EngineProcess(command, tmp_path / "no such folder" / "log.txt")
    assert collect(process)[-1]["type"] == "done"


@pytest.mark.parametrize("line", ["", "[]", "{", '{"type": 3}', '{"type": ["done"]}', '"done"', "{}"])
def test_lines_that_are_no_message(line):
    assert parse_message(line) is None


# ---------------------------------------------------------------------------------------- the sequence


class Steps:
    """A job of three steps, a function between two commands; counts what ran."""

    def __init__(self, folder: Path, **inputs) -> None:
        self.folder = folder
        self.ran: list[str] = []
        self.engine = "import json, pathlib, sys; pathlib.Path(sys.argv[1]).touch()\n" + DONE
        self.inputs = inputs

    def start(self, arguments):
        self.ran.append(Path(arguments[0]).name)
        return EngineProcess([sys.executable, "-c", self.engine, *arguments], self.folder / "log.txt")

    def note(self, name):
        def call():
            self.ran.append(name)

        return call

    def job(self, resume: bool = True, own_file: bool = True, **changed) -> Job:
        inputs = {**self.inputs, **changed}
        a, b, d = (self.folder / name for name in ("a", "b", "d"))
        steps = [
            Step("a", "A", 1.0, inputs={"x": inputs.get("a")}, command=[str(a)], outputs=[a]),
            Step("scene", "Scene", 1.0, function=self.note("scene"), repeat=True),
            Step(
                "b",
                "B",
                1.0,
                inputs={"x": inputs.get("b")},
                command=[str(b)],
                outputs=[b],
                reset=self.note("reset b"),
            ),
            Step(
                "save",
                "Save",
                1.0,
                function=self.note("save"),
                restore=self.note("restore") if own_file else None,
            ),
            Step("d", "D", 4.0, inputs={"x": inputs.get("d")}, command=[str(d)], outputs=[d]),
        ]
        record = StepRecord(self.folder / "steps.json")
        return Job(steps, record, self.start, self.folder / "log.txt", lambda: (["result"], {}), resume)

    def run(self, **changed) -> list[dict]:
        self.ran.clear()
        messages: list[dict] = []
        self.job(**changed).run(messages.append)
        return messages


def test_steps_run_in_order_and_progress_only_grows(tmp_path):
    steps = Steps(tmp_path)
    messages = steps.run()
    assert steps.ran == ["a", "scene", "reset b", "b", "save", "d"]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0
    assert messages[-1] == {"type": "done", "files": ["result"], "data": {}}
    assert [m["name"] for m in messages if m["type"] == "stage"] == ["a", "scene", "b", "save", "d"]


def test_resuming_a_finished_job_runs_nothing(tmp_path):
    steps = Steps(tmp_path)
    steps.run()
    assert steps.run()[-1]["type"] == "done" and steps.ran == []


def test_changed_inputs_invalidate_from_their_step_on(tmp_path):
    steps = Steps(tmp_path)
    steps.run()
    steps.run(b=1)
    assert steps.ran == ["scene", "reset b", "b", "save", "d"]
    steps.run(b=1, d=1)
    assert steps.ran == ["restore", "d"]
    steps.run(a=1)
    assert steps.ran == ["a", "scene", "reset b", "b", "save", "d"]


def test_a_scene_that_may_not_be_replaced_is_built_again_instead(tmp_path):
    steps = Steps(tmp_path)
    steps.run(own_file=False)
    steps.run(own_file=False, d=1)
    assert steps.ran == ["scene", "d"]


def test_a_lost_output_is_made_again_with_all_that_follows(tmp_path):
    steps = Steps(tmp_path)
    steps.run()
    (tmp_path / "b").unlink()
    steps.run()
    assert steps.ran == ["scene", "b", "save", "d"]


def test_without_resume_everything_runs(tmp_path):
    steps = Steps(tmp_path)
    steps.run()
    steps.run(resume=False)
    assert [name for name in steps.ran if name != "reset b"] == ["a", "scene", "b", "save", "d"]


def test_a_step_that_was_interrupted_keeps_its_checkpoints(tmp_path):
    steps = Steps(tmp_path)
    good = steps.engine
    steps.engine = "import pathlib, sys; sys.exit(0 if pathlib.Path(sys.argv[1]).touch() else 9)"
    messages = steps.run()
    assert messages[-1]["code"] == "engine-crashed" and steps.ran == ["a"]
    steps.engine = good
    steps.run()
    assert steps.ran[0] == "a"
    (tmp_path / "b").unlink()
    steps.engine = steps.engine.replace(
        "import json", "import json, sys; 'b' in sys.argv[1][-1] and sys.exit(7)\nimport json"
    )
    assert steps.run()[-1]["type"] == "error"
    steps.engine = good
    steps.run()
    assert "reset b" not in steps.ran and "b" in steps.ran


def test_failures_of_functions_become_messages(tmp_path):
    def fail():
        raise ZeroDivisionError("no room")

    def explain():
        raise FiptError("mesh-empty", "Empty.", "Fill it.")

    for function, code in ((fail, "blender-step-failed"), (explain, "mesh-empty")):
        step = Step("x", "Doing x", 1.0, function=function)
        record = StepRecord(tmp_path / f"{code}.json")
        job = Job([step], record, lambda arguments: None, tmp_path / "log.txt", lambda: ([], {}))
        messages: list[dict] = []
        assert job.run(messages.append) is False
        assert messages[-1]["code"] == code and job.error == messages[-1]
    assert "ZeroDivisionError" in (tmp_path / "log.txt").read_text()


def slice_job(tmp_path, function) -> Job:
    step = Step("x", "Doing x", 1.0, function=function)
    record = StepRecord(tmp_path / "steps.json")
    return Job([step], record, lambda arguments: None, tmp_path / "log.txt", lambda: ([], {}), resume=False)


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

    for error, code in (
        (FiptError("mesh-empty", "E.", "F."), "mesh-empty"),
        (KeyError(), "blender-step-failed"),
    ):
        job = slice_job(tmp_path, lambda error=error: function(error))
        assert not job.run(lambda message: None) and job.error["code"] == code
    job = slice_job(tmp_path, function)
    for _ in range(3):
        job.advance()
    assert len(closed) == 2 and not job.finished
    job.request_cancel()
    assert len(closed) == 3 and job.finished and job.cancelled and job.error is None


def test_slices_run_in_the_jobs_context_each(tmp_path):
    entered = []

    @contextmanager
    def around():
        if len(entered) == 2:
            raise FiptError("scene-gone", "Gone.", "Open it.")
        entered.append("in")
        yield
        entered[-1] = "out"

    def function():
        while True:
            assert entered[-1] == "in"
            time.sleep(SLICE_SECONDS)
            yield

    job = slice_job(tmp_path, function)
    job.around = around
    assert not job.run(lambda message: None)
    assert job.error["code"] == "scene-gone" and entered == ["out", "out"]


def test_jobs_that_share_a_record_forget_their_own_steps_alone(tmp_path):
    record = StepRecord(tmp_path / "steps.json")
    for name in ("a", "b"):
        record.store(name, "key", finished=True)
    record.forget(["b", "c"])
    assert (record.key("a"), record.key("b")) == ("key", None)


def test_warnings_are_kept_for_the_report(tmp_path):
    warning = {"type": "warning", "code": "c", "text": "t", "remedy": "r"}
    step = Step("x", "X", 1.0, function=lambda: [warning])
    record = StepRecord(tmp_path / "steps.json")
    messages: list[dict] = []
    Job([step], record, lambda arguments: None, tmp_path / "log.txt", lambda: ([], {})).run(messages.append)
    assert warning in messages
    assert json.loads((tmp_path / "steps.json").read_text())["steps"]["x"]["warnings"] == [warning]


@posix
def test_cancelling_a_job_ends_its_engine(tmp_path):
    steps = Steps(tmp_path)
    steps.engine = 'import json, os, time; print(json.dumps({"type": "stage", "name": str(os.getpid()), '
    steps.engine += '"text": ""}), flush=True); time.sleep(60)'
    job = steps.job()
    pid = None
    while pid is None:
        for message in job.advance():
            if message["type"] == "stage" and message["name"].startswith("a/"):
                pid = int(message["name"][2:])
    started = time.monotonic()
    job.cancel()
    assert time.monotonic() - started < 2.0 and not is_alive(pid)
    assert job.finished and job.cancelled and job.advance() == []


def test_keys_form_a_chain():
    def keys(*inputs):
        return chain_keys([Step(str(i), "", 1.0, inputs={"v": v}) for i, v in enumerate(inputs)])

    before, after = keys(1, 2, 3), keys(1, 5, 3)
    assert before[0] == after[0] and before[1] != after[1] and before[2] != after[2]
    assert keys(1, 2, 3) == before


@posix
def test_sigterm_is_enough_for_a_child_that_listens(tmp_path):
    process = child(tmp_path, "import time; time.sleep(60)")
    process.cancel()
    assert process.returncode == -signal.SIGTERM
