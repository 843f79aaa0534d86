# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pinned packages of the engine, the environments that contain them, PyTorch's build for a GPU."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import pins
from fipt_blender.bridge.torch_build import TORCH_INDEX, choose_torch_build, torch_index, torch_requirement
from fipt_blender.core.device.cuda import Gpu, cuda_devices, cuda_driver_version
from fipt_blender.core.run.errors import FiptError

HERE = sys.version_info[:2]
PYTHON = Path(sys.executable)


def test_pins_are_those_of_the_checkout_or_of_the_zip(tmp_path: Path) -> None:
    assert any(pin.startswith("mitsuba==") for pin in pins.read_pins()["engine"])
    (tmp_path / pins.PINS_NAME).write_text(json.dumps({"engine": ["a==1"], "llvm": [], "pip": []}))
    assert pins.read_pins(tmp_path)["engine"] == ["a==1"]
    with pytest.raises(FiptError, match="engine's packages"):
        pins.read_pins(tmp_path / "nowhere")


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
    groups = {
        "engine": [
            "OpenEXR==3.5.3",
            "numpy==1.26.4; python_version < '3.13'",
            "numpy==2.5.5",
            "torch==2.13.0",
        ]
    }
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
    device: str,
    driver: int | None,
    gpus: list[Gpu],
    linux: str,
    windows: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for platform, expected in (("linux", linux), ("win32", windows)):
        monkeypatch.setattr(sys, "platform", platform)
        assert choose_torch_build(device, driver, gpus) == expected


def test_torch_requirement_names_the_build() -> None:
    requirements = ["a==1", "torch==2.13.0; python_version > '3'"]
    assert torch_requirement(requirements, "cu126") == "torch==2.13.0+cu126; python_version > '3'"
    assert torch_requirement(requirements, "") == torch_requirement(["a==1"], "cpu") == ""
    assert torch_index("cu126") == f"{TORCH_INDEX}/cu126" and torch_index("") == ""


def test_driver_is_asked_without_harm() -> None:
    devices = cuda_devices()
    assert (cuda_driver_version() is None) == (devices == [])
    assert all(each.uuid.startswith("GPU-") for each in devices)
