# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Set-up as a child process: its plans, its messages, and one at a time."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import interpreter, pins, places, setup
from fipt_blender.bridge.torch_build import TORCH_INDEX, choose_torch_build, torch_index, torch_requirement
from fipt_blender.core.device.cuda import Gpu
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.runfolder import RunFolder
from samples.refusals import error_of
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
    caught = error_of(setup.make_plans, tmp_path, "auto", wheels)
    assert caught.code == "wheels-missing"
    version = next(pin for pin in pins.read_pins()["engine"] if pin.startswith("mitsuba")).partition("==")[2]
    other = next(each for each in pins.ENGINE_PYTHONS if each != HERE)
    (wheels / f"mitsuba-{version}-cp{other[0]}{other[1]}-cp{other[0]}{other[1]}-any.whl").touch()
    caught = error_of(setup.make_plans, tmp_path, "auto", wheels)
    assert caught.code == "python-unfit" and f"Python {other[0]}.{other[1]}" in caught.text


def test_child_process_tells_in_messages_and_says_what_is_missing(tmp_path: Path) -> None:
    """Set-up of an installed extension, with one tiny pinned package."""
    package = tmp_path / "extension"
    shutil.copytree(places.PACKAGE_FOLDER, package, ignore=shutil.ignore_patterns("__pycache__"))
    # named as the engine's main package, by which the wheels' Python is recognised
    groups = {"engine": ["mitsuba==0.0.1"], "llvm": [], "pip": []}
    (package / pins.PINS_NAME).write_text(json.dumps(groups))
    command = interpreter.setup_command(PYTHON, tmp_path / "data", "auto", tmp_path / "wheels")
    wheel = make_wheel(tmp_path / "wheels", "mitsuba", "0.0.1")
    tag = f"cp{HERE[0]}{HERE[1]}"
    wheel.rename(wheel.with_name(f"mitsuba-0.0.1-{tag}-none-any.whl"))
    installed = [part.replace(str(places.PACKAGE_FOLDER), str(package)) for part in command]
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
    stamp = pins.read_stamp(folder)
    assert stamp.installed and not stamp.complete
    # a second set-up in one data folder waits its turn
    with hold(RunFolder(tmp_path / "data"), ["set-up"]):
        result = subprocess.run(installed, capture_output=True, text=True)
    error = parse_message(result.stdout.splitlines()[-1])
    assert result.returncode == 1 and error["code"] == "run-busy"


def test_data_folder_is_the_platforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(places.DATA_VARIABLE, raising=False)
    for platform, variable in (("linux", "XDG_DATA_HOME"), ("win32", "LOCALAPPDATA")):
        monkeypatch.setattr(sys, "platform", platform)
        monkeypatch.setenv(variable, str(tmp_path / platform))
        assert places.default_data_folder() == tmp_path / platform / "fipt_blender"
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "named"))
    assert places.default_data_folder() == tmp_path / "named"


def test_run_folders_are_fresh_and_safely_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (places.new_run_folder(tmp_path, "../Living room: 2?") for _ in range(2))
    assert first != second and first.parent == second.parent == tmp_path / "runs"
    assert first.name.startswith("Living-room-2-") and not list(first.iterdir())
    assert places.new_run_folder(tmp_path, "").name.startswith("run-")
    (tmp_path / "file").touch()
    caught = error_of(places.new_run_folder, tmp_path / "file", "room")
    assert caught.code == "run-unwritable"

    def full(*arguments: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Path, "mkdir", full)
    assert error_of(places.new_run_folder, tmp_path, "room").code == "disk-full"


def test_environments_belong_to_pins_and_a_python(tmp_path: Path) -> None:
    groups = pins.read_pins()
    name = pins.environment_name(groups, HERE)
    assert name.startswith(f"engine-{HERE[0]}.{HERE[1]}-")
    assert name != pins.environment_name({**groups, "engine": ["torch==1"]}, HERE)
    other = next(version for version in pins.ENGINE_PYTHONS if version != HERE)
    names = [pins.environment_name(groups, other), name, f"engine-{HERE[0]}.{HERE[1]}-00000000"]
    for each in (*names, "engine-old", "runs"):
        (tmp_path / each).mkdir()
    assert {path.name for path in pins.environments(tmp_path)} == set(names)
    assert pins.managed_environments(tmp_path) == []
    for each in names:
        (tmp_path / each / pins.STAMP_NAME).write_text(json.dumps({"complete": True}))
    found = [path.name for path in pins.managed_environments(tmp_path)]
    assert found == [name, names[0]], "the running Python's leads, other pins do not count"
    (tmp_path / name / pins.STAMP_NAME).write_text(json.dumps({"installed": True, "complete": False}))
    assert [path.name for path in pins.managed_environments(tmp_path)] == [names[0]]


def test_folder_of_wheels_tells_its_pythons_and_the_command_names_every_pin(tmp_path: Path) -> None:
    groups = pins.read_pins()
    version = next(pin for pin in groups["engine"] if pin.startswith("mitsuba")).partition("==")[2]
    for tag in ("cp313", "cp311", "cp38"):
        (tmp_path / f"mitsuba-{version}-{tag}-{tag}-manylinux_2_28_x86_64.whl").touch()
    (tmp_path / "mitsuba-0.1-cp314-cp314-manylinux_2_28_x86_64.whl").touch()
    assert pins.wheel_pythons(tmp_path, groups) == [(3, 11), (3, 13)]
    command = pins.wheel_command(groups, (3, 13))
    assert command.startswith("python3.13 -m pip download")
    torch = next(pin for pin in groups["engine"] if pin.startswith("torch=="))
    locked = [pins.without_hashes(line) for line in groups["lock"]]
    tools = [pins.without_hashes(pin) for pin in (*groups["llvm"], *groups["pip"])]
    assert all(pin in command for pin in (torch, *locked, *tools))
    assert "--hash" not in command


def test_versions_that_are_not_the_pinned_ones_are_named() -> None:
    groups = {"engine": ["OpenEXR==3.5.3", "numpy==1.26.4; python_version < '3.13'", "numpy==2.5.5", "torch==2.13.0"]}
    good = {"openexr": "3.5.3", "numpy": "2.5.5", "torch": "2.13.0+cpu", "psutil": "1", "mitsuba": None}
    assert pins.other_versions(groups, good) == []
    named = pins.other_versions(groups, {**good, "torch": "2.1.0", "numpy": "1.0"})
    assert named == ["numpy 1.0 (1.26.4 or 2.5.5)", "torch 2.1.0 (2.13.0)"]


def gpu(*capability: int) -> Gpu:
    return Gpu("Card", "GPU-1", 8.0, (capability[0], capability[1]))


@pytest.mark.parametrize(
    ("device", "driver", "gpus", "linux", "windows"),
    [
        ("auto", None, [], "cpu", ""),
        ("llvm", 13000, [gpu(8, 6)], "cpu", ""),
        ("auto", 13010, [gpu(8, 6)], "", "cu130"),
        ("cuda", 12040, [gpu(8, 6)], "cu126", "cu126"),
        ("auto", 13000, [gpu(6, 1)], "cu126", "cu126"),  # CUDA 13 left the older cards behind
        ("auto", 13000, [gpu(6, 1), gpu(12, 0)], "", "cu130"),  # none serves both
        ("auto", 11080, [gpu(8, 6)], "cpu", ""),  # a driver too old for any
    ],
)
def test_torch_build_fits_driver_and_card(
    device: str, driver: int | None, gpus: list[Gpu], linux: str, windows: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for platform, expected in (("linux", linux), ("win32", windows)):
        monkeypatch.setattr(sys, "platform", platform)
        assert choose_torch_build(device, driver, gpus) == expected


def test_torch_requirement_names_the_build() -> None:
    requirements = ["a==1", "torch==2.13.0; python_version > '3'"]
    assert torch_requirement(requirements, "cu126") == "torch==2.13.0+cu126; python_version > '3'"
    assert torch_requirement(requirements, "") == torch_requirement(["a==1"], "cpu") == ""
    assert torch_index("cu126") == f"{TORCH_INDEX}/cu126" and torch_index("") == ""
