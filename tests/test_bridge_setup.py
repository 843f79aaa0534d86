# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Set-up as a child process: its plans, its messages, and one at a time."""

from __future__ import annotations

import errno
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import interpreter, pins, places, setup
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.runfolder import RunFolder
from samples.wheels import make_wheel

HERE = sys.version_info[:2]
PYTHON = Path(sys.executable)


def test_plans_prefer_what_stands_and_name_a_python_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup, "other_pythons", lambda: iter([]))
    plans = setup.make_plans(tmp_path, "auto", None)
    assert [plan.base for plan in plans] == [PYTHON] and plans[0].folder.parent == tmp_path
    assert plans[0].requirements == pins.read_pins()["engine"]
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    with pytest.raises(FiptError) as caught:
        setup.make_plans(tmp_path, "auto", wheels)
    assert caught.value.code == "wheels-missing"
    version = next(pin for pin in pins.read_pins()["engine"] if pin.startswith("mitsuba")).partition("==")[2]
    other = next(each for each in pins.ENGINE_PYTHONS if each != HERE)
    (wheels / f"mitsuba-{version}-cp{other[0]}{other[1]}-cp{other[0]}{other[1]}-any.whl").touch()
    with pytest.raises(FiptError, match=rf"Python {other[0]}\.{other[1]}") as caught:
        setup.make_plans(tmp_path, "auto", wheels)
    assert caught.value.code == "python-unfit"


@pytest.fixture
def installed(tmp_path: Path) -> list[str]:
    """The command line of set-up of an installed extension, with one tiny pinned package."""
    package = tmp_path / "extension"
    shutil.copytree(places.PACKAGE_FOLDER, package, ignore=shutil.ignore_patterns("__pycache__"))
    # named as the engine's main package, by which the wheels' Python is recognised
    groups = {"engine": ["mitsuba==0.0.1"], "llvm": [], "pip": []}
    (package / pins.PINS_NAME).write_text(json.dumps(groups))
    command = interpreter.setup_command(PYTHON, tmp_path / "data", "auto", tmp_path / "wheels")
    wheel = make_wheel(tmp_path / "wheels", "mitsuba", "0.0.1")
    tag = f"cp{HERE[0]}{HERE[1]}"
    wheel.rename(wheel.with_name(f"mitsuba-0.0.1-{tag}-none-any.whl"))
    return [part.replace(str(places.PACKAGE_FOLDER), str(package)) for part in command]


def test_child_process_tells_in_messages_and_says_what_is_missing(
    installed: list[str], tmp_path: Path
) -> None:
    result = subprocess.run(installed, capture_output=True, text=True, cwd=tmp_path)
    messages = [parse_message(line) for line in result.stdout.splitlines()]
    assert None not in messages, "nothing but messages on stdout"
    names = [message["name"] for message in messages if message["type"] == "stage"]
    assert list(dict.fromkeys(names)) == ["environment", "packages", "libraries"]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions)
    # the only pinned package is installed; the engine's others are missed
    assert result.returncode == 1 and messages[-1]["code"] == "package-broken"
    assert "torch" in messages[-1]["text"] and "pip install" in result.stderr
    (folder,) = pins.environments(tmp_path / "data")
    assert pins.read_stamp(folder)["installed"] and not pins.read_stamp(folder)["complete"]


def test_second_set_up_in_one_data_folder_waits_its_turn(installed: list[str], tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    with hold(RunFolder(data), ["set-up"]):
        result = subprocess.run(installed, capture_output=True, text=True)
    error = parse_message(result.stdout.splitlines()[-1])
    assert result.returncode == 1 and error["code"] == "run-busy"


def test_stdout_of_set_up_is_for_messages_alone() -> None:
    stdout = io.StringIO()
    listener = setup.SetupReporter(stdout)
    listener.plan((1.0, 1.0))
    listener.stage("a", "A")
    listener.detail("more of A")
    lines = [json.loads(line) for line in stdout.getvalue().splitlines()]
    assert [line["text"] for line in lines if line["type"] == "stage"] == ["A", "more of A"]
    assert {line["index"] for line in lines if line["type"] == "stage"} == {0}


def test_data_folder_is_the_platforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(places.DATA_VARIABLE, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert places.default_data_folder() == tmp_path / "fipt_blender"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert places.default_data_folder() == tmp_path / "local" / "fipt_blender"
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "named"))
    assert places.default_data_folder() == tmp_path / "named"


def test_run_folders_are_fresh_and_safely_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (places.new_run_folder(tmp_path, "../Living room: 2?") for _ in range(2))
    assert first != second and first.parent == second.parent == tmp_path / "runs"
    assert first.name.startswith("Living-room-2-") and not list(first.iterdir())
    assert places.new_run_folder(tmp_path, "").name.startswith("run-")
    (tmp_path / "file").touch()
    with pytest.raises(FiptError) as caught:
        places.new_run_folder(tmp_path / "file", "room")
    assert caught.value.code == "run-unwritable"

    def full(*arguments: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(FiptError) as caught:
        places.new_run_folder(tmp_path, "room")
    assert caught.value.code == "disk-full"
