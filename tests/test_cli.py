"""The command line: usage, exit status, output for people and for scripts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fipt_blender import cli
from fipt_blender.bridge.job import Job
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.step import Step
from samples.child_processes import PATIENCE_SECONDS, SLEEPER, is_alive, posix, wait_for

PACKAGE = Path(cli.__file__).parent.parent
GOOD = """
for fraction in (0.0, 0.5, 1.0): print('{"type": "progress", "fraction": %.1f, "remaining_seconds": 70}' % fraction)
print('{"type": "warning", "code": "w", "text": "Odd.", "remedy": "Even it."}')
print('{"type": "done", "files": [], "data": {}}')
"""
BAD = """
print('{"type": "error", "code": "mesh-empty", "text": "No mesh.", "remedy": "Give one."}')
raise SystemExit(1)
"""


@pytest.fixture
def capture(tmp_path, monkeypatch):
    """A folder to name as capture, and the working directory for default outputs."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "room"
    folder.mkdir()
    return folder


def fake_job(monkeypatch, script: str) -> list:
    """Replace the main job by one engine command; returns the options that it was made with."""
    seen = []

    def make(options):
        seen.append(options)
        options.output.mkdir(exist_ok=True)
        log = options.output / "log.txt"
        result = options.output / "result.bin"
        result.write_bytes(b"x" * 1500)
        command = [sys.executable, "-c", script]
        step = Step("estimate", "Estimating", 1.0, process=lambda: EngineProcess(command, log))
        return Job([step], log, result=lambda: ([str(result)], {}))

    monkeypatch.setattr(cli, "make_main_job", make)
    return seen


WRONG = "--preset best|--seed x|--set rounds|--set no_such_setting=1|--set rounds=many|--rounds -1|--scale 0"
WRONG += "|--scale nan|--hold-back 1|--render-spp 0|--parts guess"


@pytest.mark.parametrize("line", ["", "dance", "estimate", *(f"estimate room {option}" for option in WRONG.split("|"))])
def test_wrong_usage_is_status_2_with_text_on_stderr(line, capsys):
    assert cli.main(line.split()) == 2
    output = capsys.readouterr()
    assert "error: " in output.err and output.out == ""


def test_captures_whose_names_differ_have_different_output_folders(capture, monkeypatch):
    cameras = capture / "cameras.json"
    cameras.touch()
    folders = [capture.parent / name for name in ("room.v1", "room.v2")]
    for folder in folders:
        folder.mkdir()
    jobs = fake_job(monkeypatch, GOOD)
    for path in (*folders, capture, cameras):
        assert cli.main(["estimate", str(path)]) == 0
    names = [options.output.name for options in jobs]
    assert names == ["room.v1-fipt", "room.v2-fipt", "room-fipt", "room-fipt"]


def test_options_reach_the_job(capture, monkeypatch, capsys):
    seen = fake_job(monkeypatch, GOOD)
    arguments = "estimate room --preset draft --seed 7 --device llvm --rounds 0 --set texel_density=64 --resume"
    arguments += " --no-renders --up-axis=-y --scale 0.01 --hold-back 5 --parts none --mesh m.obj"
    assert cli.main(arguments.split()) == 0
    options = seen[0]
    settings = options.settings
    assert (settings.preset, settings.seed, settings.device, settings.rounds) == ("draft", 7, "llvm", 0)
    assert settings.texel_density == 64.0 and not options.renders and options.resume
    assert (options.up_axis, options.scale, options.hold_back) == ("-y", 0.01, 5)
    assert (options.parts, options.mesh) == ("none", Path("m.obj"))
    assert options.output == capture.parent / "room-fipt"


def test_a_good_run_shows_progress_and_ends_with_the_files_and_a_bad_one_with_status_1(capture, monkeypatch, capfd):
    fake_job(monkeypatch, GOOD)
    assert cli.main(["estimate", "room"]) == 0
    output = capfd.readouterr()
    lines = output.out.splitlines()
    assert lines[0].strip().startswith("0 %") and "Estimating" in lines[0]
    assert lines[-1].split() == ["1.5", "kB", str(capture.parent / "room-fipt" / "result.bin")]
    assert output.err == "warning: Odd. Even it.\n"
    fake_job(monkeypatch, BAD)
    assert cli.main(["estimate", "room", "--output", "bad"]) == 1
    assert "error: No mesh. Give one.\n" in capfd.readouterr().err


def test_what_blender_prints_meanwhile_goes_to_the_log(capture, monkeypatch, capfd):
    def make(options):
        options.output.mkdir()
        step = Step("a", "A", 1.0, function=lambda: os.write(1, b"Fra:1 Mem:20M\n") and None)
        return Job([step], options.output / "log.txt")

    monkeypatch.setattr(cli, "make_main_job", make)
    assert cli.main(["estimate", str(capture), "--output", "out", "--json"]) == 0
    os.write(1, b"after\n")
    *messages, after = capfd.readouterr().out.splitlines()
    types = [json.loads(line)["type"] for line in messages]
    assert (types[0], types[-1], after) == ("stage", "done", "after")
    assert "Fra:1 Mem:20M\n" in Path("out/log.txt").read_text()


TELL_ID = """import os; print('{"type": "stage", "name": "%d", "text": ""}' % os.getpid(), flush=True)"""
INTERRUPTED = """
import sys
sys.path.insert(0, sys.argv[1])
from fipt_blender import cli
from fipt_blender.bridge.process import EngineProcess
from fipt_blender.bridge.job import Job
from fipt_blender.bridge.step import Step
def make(options):
    options.output.mkdir()
    log = options.output / "log.txt"
    start = lambda: EngineProcess([sys.executable, "-c", sys.argv[2]], log)
    return Job([Step("a", "A", 1.0, process=start)], log)
cli.make_main_job = make
sys.exit(cli.main(["estimate", "room", "--json"]))
"""


@posix
def test_ctrl_c_ends_the_engine_and_says_how_to_go_on(capture):
    command = [sys.executable, "-c", INTERRUPTED, str(PACKAGE.parent), f"{TELL_ID}\n{SLEEPER}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    engine = None
    while engine is None:
        message = json.loads(process.stdout.readline())
        if message["type"] == "stage" and message["name"].startswith("a/"):
            engine = int(message["name"][2:])
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_SECONDS)  # the engine would sleep far longer
    assert process.returncode == 130
    assert "--resume" in errors and "Traceback" not in errors
    wait_for(lambda: not is_alive(engine))


@pytest.mark.parametrize("command", [[str(PACKAGE / "__main__.py")], ["-m", PACKAGE.name], [str(PACKAGE)]])
def test_the_package_runs_as_a_file_and_as_a_module(command, tmp_path):
    for arguments, status in ((["dance"], 2), (["estimate", "no such folder"], 1)):
        folder = PACKAGE.parent if command[0] == "-m" else tmp_path
        line = [sys.executable, *command, *arguments]
        result = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
        assert result.returncode == status, result.stderr
        assert "Traceback" not in result.stderr
    assert "error: The capture no such folder does not exist." in result.stderr
    assert list(tmp_path.iterdir()) == []
