# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's process, tested with small child processes that each misbehave in one way."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import process as engine_process
from fipt_blender.bridge.death import explain_death
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import parse_message
from samples.child_processes import SLEEPER, frozen_clock, is_alive, posix, wait_for
from samples.refusals import error_of


def child(tmp_path: Path, script: str) -> EngineProcess:
    return EngineProcess([sys.executable, "-c", script], tmp_path / "log.txt")


def collect(process: EngineProcess) -> list[dict]:
    messages: list[dict] = []
    process.run_blocking(messages.append)
    return messages


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
def test_cancel_ends_a_stubborn_child_and_its_children_by_force(tmp_path):
    script = (
        "import json, signal, subprocess, sys, time\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "inner = 'import json, os, signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)\\n'\n"
        'inner += \'m = {"type": "stage", "name": str(os.getpid()), "text": ""}\\n\'\n'
        "inner += 'print(json.dumps(m), flush=True)\\n'\n"
        "grandchild = subprocess.Popen([sys.executable, '-c', inner + 'time.sleep(3600)'])\n"
        "time.sleep(3600)\n"
    )
    process = child(tmp_path, script)
    messages: list[dict] = []
    while not messages:
        messages = process.poll()
    grandchild = int(messages[0]["name"])
    assert is_alive(process.pid) and is_alive(grandchild)
    process.cancel()  # returns long before they would end by themselves
    # Killed, but the system may not have got to it.
    wait_for(lambda: not is_alive(process.pid) and not is_alive(grandchild))
    assert process.cancelled and not process.running and process.poll() == [] and process.error is None


@posix
def test_an_exception_in_the_receiver_leaves_no_orphan(tmp_path):
    process = child(
        tmp_path,
        "import json, time\n"
        'print(json.dumps({"type": "stage", "name": "a", "text": "A"}), flush=True); time.sleep(3600)',
    )

    def stop(message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        process.run_blocking(stop)
    wait_for(lambda: not is_alive(process.pid))


@posix
def test_the_child_runs_in_a_group_of_its_own_and_nicely(tmp_path):
    expected = max(10, os.nice(0))  # a caller may be nicer still
    script = (
        "import json, os, time\nend = time.monotonic() + 300\n"
        f"while os.nice(0) < {expected} and time.monotonic() < end: time.sleep(0.01)\n"
        'data = {"group": os.getpgrp(), "nice": os.nice(0)}\n'
        'print(json.dumps({"type": "done", "files": [], "data": data}))'
    )
    process = child(tmp_path, script)
    data = collect(process)[-1]["data"]
    assert data["group"] == process.pid != os.getpgrp()
    assert data["nice"] == expected


@pytest.mark.parametrize(
    "line",
    [
        *("", "[]", "{", '{"type": 3}', '{"type": ["done"]}', '"done"', "{}", "{" * 100_000),
        '{"type": "stage", "name": "a"}',
        '{"type": "stage", "name": "a", "text": null}',
        '{"type": "progress"}',
        '{"type": "progress", "fraction": "0.5"}',
        '{"type": "progress", "fraction": NaN}',
        '{"type": "progress", "fraction": 0.5, "files": "abc"}',
        '{"type": "warning", "code": "a", "text": "b"}',
        '{"type": "error", "code": "a", "text": "b", "remedy": 5}',
        '{"type": "done"}',
        '{"type": "done", "files": [1], "data": {}}',
        '{"type": "done", "files": [], "data": []}',
    ],
)
def test_lines_that_are_no_message(line):
    assert parse_message(line) is None


@posix
def test_sigterm_is_enough_for_a_child_that_listens(tmp_path, monkeypatch):
    engine = child(tmp_path, SLEEPER)
    monkeypatch.setattr(engine_process, "time", frozen_clock())  # it is never late, therefore not killed
    engine.request_cancel()
    wait_for(lambda: engine.poll() == [] and not engine.running)
    assert engine.returncode == -signal.SIGTERM


def test_a_second_start_on_the_same_messages_is_refused_and_harms_no_first(tmp_path):
    messages, log = tmp_path / "messages" / "a.jsonl", tmp_path / "log.txt"
    script = (
        "import json, pathlib, time\n"
        'print(json.dumps({"type": "progress", "fraction": 0.5}), flush=True)\n'
        f"while not pathlib.Path({str(tmp_path / 'go')!r}).exists(): time.sleep(0.01)\n" + DONE
    )
    command = [sys.executable, "-c", script]
    first = EngineProcess(command, log, messages=messages)
    wait_for(lambda: messages.read_bytes())
    for _ in range(2):
        assert error_of(EngineProcess, command, log, messages=messages).code == "run-busy"
    (tmp_path / "go").touch()
    assert [message["type"] for message in collect(first)] == ["progress", "done"]
    assert [message["type"] for message in collect(EngineProcess(command, log, messages=messages))]


@posix
def test_an_engine_that_was_left_keeps_its_messages(tmp_path):
    messages, log = tmp_path / "a.jsonl", tmp_path / "log.txt"
    first = EngineProcess([sys.executable, "-c", SLEEPER], log, messages=messages)
    first.leave()
    try:
        with pytest.raises(FiptError):
            EngineProcess([sys.executable, "-c", "pass"], log, messages=messages)
    finally:
        os.kill(first.pid, signal.SIGKILL)
