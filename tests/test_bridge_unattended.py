# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An engine without a watching process: its lock, finding it, a full disk, stopping it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fipt_blender.bridge import process as engine_process
from fipt_blender.bridge.attached import AttachedEngine, find_engine
from fipt_blender.bridge.death import explain_death
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.sequence import Job
from fipt_blender.bridge.step import Step, StepRecord
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.lock import hold, holder
from fipt_blender.core.run.process_identity import PARENT_VARIABLE
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs import run_job
from samples.child_processes import ENGINE, SLEEPER, frozen_clock, is_alive, posix, wait_for
from samples.refusals import error_of

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def engine(run_folder: RunFolder) -> Iterator[EngineProcess]:
    """An engine that works in `run_folder` as if another Blender had started it."""
    command = [sys.executable, "-c", ENGINE, str(ROOT), str(run_folder.root)]
    process = EngineProcess(command, run_folder.log, messages=run_folder.messages("estimate"))
    wait_for(lambda: find_engine(run_folder))
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
def test_the_lock_goes_with_a_killed_engine_whose_death_is_explained(run_folder, engine):
    engine.leave()
    attached = AttachedEngine(run_folder, find_engine(run_folder))
    os.kill(engine.pid, signal.SIGKILL)
    messages: list[dict] = []
    wait_for(lambda: messages.extend(attached.poll()) or not attached.running)
    assert messages[-1]["code"] == "engine-crashed" and "Resume" in messages[-1]["remedy"]
    with hold(run_folder, ["report"]):
        assert holder(run_folder).command == ("report",)
    assert holder(run_folder) is None


def test_an_engine_that_was_left_is_watched_to_its_end(run_folder, engine):
    engine.leave()
    assert engine.poll() == [] and is_alive(engine.pid)
    attached = AttachedEngine(run_folder, find_engine(run_folder))
    messages: list[dict] = []
    wait_for(lambda: messages.extend(attached.poll()) or len(messages) == 4)
    assert [message["type"] for message in messages] == ["stage", "progress", "progress", "warning"]
    assert attached.running
    (run_folder.root / "stop").touch()
    wait_for(lambda: messages.extend(attached.poll()) or not attached.running)
    assert messages[-1]["type"] == "done" and attached.error is None
    assert "a stray line" in run_folder.log.read_text()


@posix
def test_a_process_with_the_id_of_a_dead_engine_is_left_alone(run_folder):
    other = subprocess.Popen([sys.executable, "-c", SLEEPER], start_new_session=True)
    try:
        dead = json.dumps({"pid": other.pid, "command": ["estimate"]})
        run_folder.messages("estimate").parent.mkdir()
        run_folder.messages("estimate").touch()
        run_folder.engine_lock.write_text(dead)
        assert find_engine(run_folder) is None
        with hold(run_folder, ["estimate"]):
            attached = AttachedEngine(run_folder, find_engine(run_folder))
        run_folder.engine_lock.write_text(dead)
        attached.cancel()
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()


@posix
@pytest.mark.parametrize(
    "other_content", [{"host": "another-machine"}, {"started": "another boot 5"}, {"host": "", "started": ""}]
)
def test_a_process_is_left_alone_where_the_engine_runs_on_another_machine(run_folder, engine, other_content):
    """On storage that machines share, the lock's id may be that of an innocent process here."""
    content = json.loads(run_folder.engine_lock.read_text())
    run_folder.engine_lock.write_text(json.dumps({**content, **other_content}))  # still locked
    found = find_engine(run_folder)
    assert found is not None and not found.is_here
    attached = AttachedEngine(run_folder, found)
    step = Step("estimate", "Estimate", 1.0, command=["estimate"])
    record = StepRecord(run_folder.root / "steps.json")
    job = Job([step], record, lambda arguments: attached, run_folder.log, lambda: ([], {}), resume=False)
    wait_for(lambda: job.advance() is None or job.waits)
    caught = error_of(job.request_cancel)
    assert caught.code == "engine-elsewhere" and str(engine.pid) in caught.text
    assert not job.cancelled
    with pytest.raises(FiptError, match=other_content.get("host") or str(engine.pid)):
        run_job.refuse_busy(run_folder)
    attached.request_cancel()
    attached.poll()
    job.cancel()
    assert is_alive(engine.pid) and not attached.running


def test_the_command_of_a_lock_names_no_other_file_and_nonsense_is_nobodys(run_folder):
    (run_folder.root.parent / "evil.jsonl").touch()
    run_folder.messages("estimate").parent.mkdir()
    with hold(run_folder, ["../../evil"]):
        assert holder(run_folder) is not None and find_engine(run_folder) is None
        for text in ("", "{", "[]", '{"pid": "x", "command": []}', '{"pid": 1}'):  # still locked
            run_folder.engine_lock.write_text(text)
            assert holder(run_folder) is None and find_engine(run_folder) is None


def test_a_job_attaches_and_notes_that_its_step_is_finished(run_folder, engine):
    record = StepRecord(run_folder.root / "steps.json")
    record.store("estimate", "the key of then", finished=False)
    steps = [Step("estimate", "Estimating", 1.0, command=["estimate"], reset=lambda: pytest.fail("kept"))]
    job = run_job.attach_job(run_folder, steps)
    assert job is not None
    messages: list[dict] = []
    for _ in range(5):
        messages += job.advance()
    assert "estimate/shadings" in [message.get("name") for message in messages]
    (run_folder.root / "stop").touch()
    assert job.run(messages.append) and messages[-1]["type"] == "done"
    step = json.loads((run_folder.root / "steps.json").read_text())["steps"]["estimate"]
    assert step["finished"] and step["key"] == "the key of then"
    assert [warning["code"] for warning in step["warnings"]] == ["odd"]
    assert run_job.attach_job(run_folder, steps) is None


@posix
def test_a_request_to_cancel_never_waits(run_folder, monkeypatch):
    stubborn = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('{}', flush=True)\n"
    command, log = [sys.executable, "-c", stubborn + SLEEPER], run_folder.log
    engine = EngineProcess(command, log, messages=run_folder.messages("a"))
    step = Step("a", "A", 1.0, command=["a"])
    job = Job([step], StepRecord(run_folder.root / "s.json"), lambda _: engine, log, lambda: ([], {}))
    for _ in range(3):
        job.advance()
    wait_for(lambda: run_folder.messages("a").stat().st_size)
    monkeypatch.setattr(engine_process, "time", frozen_clock())
    job.request_cancel()
    for _ in range(10):  # the child does not listen, and is given time to
        assert job.advance() == [] and not job.finished and is_alive(engine.pid)
    monkeypatch.setattr(engine_process, "time", frozen_clock(2.0))
    wait_for(lambda: job.advance() == [] and job.finished)
    assert job.cancelled and job.error is None and not is_alive(engine.pid)


@posix
def test_in_background_the_engine_ends_with_who_started_it(tmp_path):
    # The child starts the engine's watch in a grandchild and is then killed, as a batch run may be.
    watch = (
        f"import os, sys, time; sys.path.insert(0, {str(ROOT)!r})\n"
        "from fipt_blender.core.run.process_identity import end_with_parent\n"
        "end_with_parent(); print(os.getpid(), flush=True); time.sleep(3600)"
    )
    script = (
        "import os, subprocess, sys, time\n"
        f"environment = {{**os.environ, {PARENT_VARIABLE!r}: str(os.getpid())}}\n"
        f"subprocess.Popen([sys.executable, '-c', {watch!r}], env=environment).wait()"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
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


def test_running_out_of_memory_is_told_from_a_crash():
    for line in ("torch.OutOfMemoryError: CUDA out of memory.", "terminate called: std::bad_alloc"):
        assert explain_death(-6, line)["code"] == "out-of-memory"
    assert explain_death(-6, "assertion failed")["code"] == "engine-crashed"
    assert "exit status" not in explain_death(None)["text"]
