"""The engine's process: misbehaving children, its lock, a full disk, stopping it."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from fipt_blender.bridge import process as engine_process
from fipt_blender.bridge.death import explain_death
from fipt_blender.bridge.job import Job
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.step import Step
from fipt_blender.core import __main__ as commands
from fipt_blender.core.report import page
from fipt_blender.core.run.lock import hold, holder
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.process_identity import PARENT_VARIABLE
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import run_job
from samples.child_processes import ENGINE, SLEEPER, frozen_clock, is_alive, posix, wait_for
from samples.refusals import error_of

ROOT = Path(__file__).resolve().parent.parent
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
    wait_for(lambda: messages.extend(process.poll()) or not process.running)
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
    job = Job([Step("a", "A", 1.0, process=lambda: process)], tmp_path / "log.txt")
    with pytest.raises(KeyboardInterrupt):
        job.run(Mock(side_effect=[None, None, KeyboardInterrupt]))  # told of stage, start and half
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


def test_lines_that_are_no_message():
    for line in ("", "{", "{" * 100_000, *map(json.dumps, ({"type": 3}, {"type": ["done"]}, {}, [], "done"))):
        assert parse_message(line) is None, line
    assert parse_message(json.dumps(DONE)) == DONE


@posix
def test_sigterm_is_enough_for_a_child_that_listens(tmp_path, monkeypatch):
    engine = child(tmp_path, SLEEPER)
    monkeypatch.setattr(engine_process, "time", frozen_clock())  # it is never late, therefore not killed
    engine.request_cancel()
    wait_for(lambda: engine.poll() == [] and not engine.running)
    assert engine.returncode == -signal.SIGTERM


@posix
@pytest.mark.parametrize("fault", [None, OSError(), subprocess.TimeoutExpired("taskkill", 1.0)])
def test_on_windows_the_whole_tree_ends(tmp_path, monkeypatch, fault):
    """Windows leaves the children of an ended process running: pip's, for example."""
    engine = child(tmp_path, said(HALF) + SLEEPER)
    asked = []

    def taskkill(command, **options):
        asked.append(command)
        if fault is not None:
            raise fault
        os.kill(engine.pid, signal.SIGKILL)

    monkeypatch.setattr(engine_process, "sys", SimpleNamespace(platform="win32"))
    monkeypatch.setattr(engine_process.subprocess, "run", taskkill)
    engine.cancel()
    assert asked[0][0].endswith("taskkill.exe") and asked[0][1:] == ["/T", "/F", "/PID", str(engine.pid)]
    wait_for(lambda: not is_alive(engine.pid))
    assert engine.cancelled and not engine.running


def test_a_second_start_on_the_same_messages_is_refused_and_harms_no_first(tmp_path):
    messages, log = tmp_path / "messages" / "a.jsonl", tmp_path / "log.txt"
    command = [sys.executable, "-c", said(HALF) + waiting_for(tmp_path / "go") + said(DONE)]
    first = EngineProcess(command, log, messages=messages)
    wait_for(lambda: messages.read_bytes())
    for _ in range(2):
        assert error_of(EngineProcess, command, log, messages=messages).code == "run-busy"
    (tmp_path / "go").touch()
    assert collect(first) == [HALF, DONE] == collect(EngineProcess(command, log, messages=messages))


@pytest.fixture
def engine(run_folder: RunFolder) -> Iterator[EngineProcess]:
    """An engine that works in `run_folder` as if another Blender had started it."""
    command = [sys.executable, "-c", ENGINE, str(ROOT), str(run_folder.root)]
    process = EngineProcess(command, run_folder.log, messages=run_folder.messages("estimate"))
    wait_for(lambda: holder(run_folder))
    yield process
    process.cancel()


def test_the_lock_keeps_others_out_and_names_its_holder(run_folder, engine):
    found = holder(run_folder)
    assert found is not None
    assert (found.pid, found.command) == (engine.pid, ("estimate", str(run_folder.root)))
    # The holder goes on until it is told to stop: who waited for the lock would never come back.
    assert error_of(hold(run_folder, ["report"]).__enter__).code == "run-busy" and is_alive(engine.pid)
    assert error_of(run_job.open_job, run_folder, []).code == "run-busy"
    command = [sys.executable, "-m", "fipt_blender.core", "report", str(run_folder.root)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    message = json.loads(result.stdout.splitlines()[-1])
    assert (message["type"], message["code"]) == ("error", "run-busy") and message["remedy"]


@posix
def test_a_request_to_cancel_never_waits(run_folder, monkeypatch):
    stubborn = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('{}', flush=True)\n"
    command, log = [sys.executable, "-c", stubborn + SLEEPER], run_folder.log
    engine = EngineProcess(command, log, messages=run_folder.messages("a"))
    job = Job([Step("estimate", "Estimate", 1.0, process=lambda: engine)], log)
    for _ in range(3):
        job.advance()
    wait_for(lambda: run_folder.messages("a").stat().st_size)
    monkeypatch.setattr(engine_process, "time", frozen_clock())
    job.request_cancel()
    for _ in range(10):  # the child does not listen, and is given time to
        assert job.advance() == [] and not job.ended and is_alive(engine.pid)
    monkeypatch.setattr(engine_process, "time", frozen_clock(2.0))
    wait_for(lambda: job.advance() == [] and job.ended)
    assert job.cancelled and job.error is None and not is_alive(engine.pid)


@posix
def test_the_engine_ends_with_who_started_it(tmp_path):
    # The child starts the engine's watch in a grandchild and is then killed, as Blender may be.
    watch = "import os\nfrom fipt_blender.core.run.process_identity import end_with_parent\nend_with_parent()\n"
    watch += f"print(os.getpid(), flush=True)\n{SLEEPER}"
    script = f"import os, subprocess, sys\nos.environ[{PARENT_VARIABLE!r}] = str(os.getpid())\n"
    script += f"subprocess.run([sys.executable, '-c', {watch!r}])"
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    engine = int(parent.stdout.readline())
    time.sleep(1.5)  # the watch has looked at its parent at least once
    assert is_alive(engine)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait_for(lambda: not is_alive(engine))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
def test_an_engine_whose_last_words_do_not_fit_on_the_disk_is_understood(run_folder):
    command = [sys.executable, "-m", "fipt_blender.core", "report", str(run_folder.root)]
    with open("/dev/full", "w") as full:
        result = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.DEVNULL, check=False)
    assert explain_death(result.returncode)["code"] == "disk-full"


def test_a_disk_that_fills_at_work_is_one_error(run_folder, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(page, "run", fail)
    stream = io.StringIO()
    assert commands.run_command(["report", str(run_folder.root)], Reporter(stream)) == 1
    assert [parse_message(line)["code"] for line in stream.getvalue().splitlines()] == ["disk-full"]


def test_running_out_of_memory_is_told_from_a_crash():
    for line in ("torch.OutOfMemoryError: CUDA out of memory.", "terminate called: std::bad_alloc"):
        assert explain_death(-6, line)["code"] == "out-of-memory"
    assert explain_death(-6, "assertion failed")["code"] == "engine-crashed"
    assert "exit status" not in explain_death(None)["text"]
