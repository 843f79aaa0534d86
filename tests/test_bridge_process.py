# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's process, tested with small child processes that each misbehave in one way."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import process as engine_process
from fipt_blender.bridge.death import explain_death
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.core.run.messages import parse_message
from samples.child_processes import SLEEPER, frozen_clock, is_alive, posix, wait_for
from samples.refusals import error_of

DONE = {"type": "done", "files": ["a"], "data": {}}
HALF = {"type": "progress", "fraction": 0.5}


def said(message: dict) -> str:
    """A line of a script that writes a message."""
    return f"print({json.dumps(message)!r}, flush=True)\n"


def waiting_for(path: Path) -> str:
    """Lines of a script that wait for a file."""
    return f"import pathlib, time\nwhile not pathlib.Path({str(path)!r}).exists(): time.sleep(0.01)\n"


def child(tmp_path: Path, script: str) -> EngineProcess:
    return EngineProcess([sys.executable, "-c", script], tmp_path / "log.txt")


def collect(process: EngineProcess) -> list[dict]:
    messages: list[dict] = []
    process.run_blocking(messages.append)
    return messages


def test_messages_arrive_and_stray_output_goes_to_the_log(tmp_path):
    script = (
        'import os\nprint("hello from a library")\nprint("{not json}")\n'
        + said({"type": "unheard-of", "x": 1})
        + said(HALF)
        + 'os.write(1, b"\\xff\\xfe broken utf-8\\n")\nos.write(2, b"on stderr\\n")\n'
        + said(DONE)
    )
    process = child(tmp_path, script)
    assert collect(process) == [HALF, DONE]
    assert process.error is None and process.done["files"] == ["a"] and process.returncode == 0
    log = (tmp_path / "log.txt").read_bytes()
    for text in (b"hello from a library", b"{not json}", b"unheard-of", b"broken utf-8", b"on stderr"):
        assert text in log


def test_poll_never_waits_and_much_output_is_read_whole(tmp_path):
    script = f"for _ in range(20000): print({json.dumps(HALF)!r})\nprint(end='', flush=True)\n"
    process = child(tmp_path, script + waiting_for(tmp_path / "go") + said(DONE))
    messages = process.poll()  # would it wait for the end, that would never come
    assert process.running
    (tmp_path / "go").touch()
    assert len(messages) + len(collect(process)) == 20001


@posix
@pytest.mark.parametrize(
    ("end", "code", "words"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "engine-crashed", ("SIGSEGV", "deep trouble")),
        ("os.kill(os.getpid(), signal.SIGKILL)", "out-of-memory", ()),  # a kill from outside is taken for that
        ("pass", "engine-crashed", ()),  # no message, though status zero
        ("sys.exit(3)", "engine-crashed", ("exit status 3",)),
    ],
)
def test_an_end_without_a_message_is_explained(tmp_path, end, code, words):
    process = child(tmp_path, f"import os, signal, sys\nprint('deep trouble', flush=True)\n{end}")
    last = collect(process)[-1]
    assert (last["type"], last["code"]) == ("error", code) and last["remedy"] and process.error == last
    assert all(word in last["text"] for word in words)


def test_statuses_of_a_shell_are_explained_and_the_childs_own_error_is_not_covered_by_another(tmp_path):
    assert explain_death(137)["code"] == "out-of-memory" and "SIGABRT" in explain_death(134)["text"]
    script = said({"type": "error", "code": "mesh-empty", "text": "t", "remedy": "r"}) + "raise SystemExit(1)"
    assert [message["code"] for message in collect(child(tmp_path, script))] == ["mesh-empty"]


@posix
def test_cancel_ends_a_stubborn_child_and_its_children_by_force(tmp_path):
    stubborn = "import os, signal, subprocess, sys, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    inner = stubborn + """print('{"type": "stage", "name": "%d", "text": ""}' % os.getpid(), flush=True)\n"""
    process = child(tmp_path, f"{stubborn}subprocess.Popen([sys.executable, '-c', {inner + SLEEPER!r}])\n{SLEEPER}")
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
    process = child(tmp_path, said(HALF) + SLEEPER)

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
    command = [sys.executable, "-c", said(HALF) + waiting_for(tmp_path / "go") + said(DONE)]
    first = EngineProcess(command, log, messages=messages)
    wait_for(lambda: messages.read_bytes())
    for _ in range(2):
        assert error_of(EngineProcess, command, log, messages=messages).code == "run-busy"
    (tmp_path / "go").touch()
    assert collect(first) == [HALF, DONE] == collect(EngineProcess(command, log, messages=messages))


@posix
def test_an_engine_that_was_left_keeps_its_messages(tmp_path):
    messages, log = tmp_path / "a.jsonl", tmp_path / "log.txt"
    first = EngineProcess([sys.executable, "-c", SLEEPER], log, messages=messages)
    first.leave()
    try:
        assert error_of(EngineProcess, [sys.executable, "-c", "pass"], log, messages=messages).code == "run-busy"
    finally:
        os.kill(first.pid, signal.SIGKILL)
