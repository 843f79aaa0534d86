"""LLVM and variants: order of candidates, libraries that abort, cached verdicts, the engine's interpreter."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from fipt_blender.bridge import interpreter, places
from fipt_blender.core.device import llvm, probe, variant
from samples.refusals import error_of

ROOT = Path(__file__).resolve().parent.parent
PYTHON = Path(sys.executable)
linux = pytest.mark.skipif(sys.platform != "linux", reason="uses a shell script and Linux' library names")


def make_library(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(name.encode())
    return folder / name


def fake_python(folder: Path, script: str) -> Path:
    """An interpreter that records each start, with the LLVM that it was given, and then runs a shell script."""
    folder.mkdir(parents=True, exist_ok=True)
    python = folder / "python"
    python.write_text(f'#!/bin/sh\necho "$DRJIT_LIBLLVM_PATH" >> "{folder}/starts"\n{script}\n')
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    return python


def starts(python: Path) -> list[str]:
    file = python.parent / "starts"
    return file.read_text().split() if file.exists() else []


@pytest.fixture
def no_other(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither the system nor a variable names a library; the environment and the cache are empty."""
    monkeypatch.setattr(llvm.sys, "prefix", str(tmp_path))
    monkeypatch.setenv("FIPT_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv(llvm.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(llvm, "system_patterns", lambda: iter([]))


def test_version_from_name_prefers_good_ones_and_counts_links_once(tmp_path: Path) -> None:
    versions = {
        "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1": 19,
        "/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1": 14,
        "/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1": 15,
        "/usr/lib/llvm-17/lib/libLLVM.so": 17,
        "/opt/homebrew/Cellar/llvm@20/20.1.8/lib/libLLVM.dylib": 20,
        "/opt/homebrew/Cellar/llvm/21.1.0/lib/libLLVM.dylib": 21,
        "/somewhere/libLLVM.so": 0,
    }
    assert {path: llvm.library_version(Path(path)) for path in versions} == versions
    names = [f"libLLVM{end}" for end in ("-14.so.1", "-99.so.1", ".so.17.0", ".so.20.1", ".so", "-15.so")]
    libraries = [make_library(tmp_path, name) for name in names]
    link = tmp_path / "libLLVM-20.so"
    link.symlink_to(libraries[3])
    ordered = [path.name for path in llvm.order_candidates([*libraries, link, tmp_path / "libLLVM-21.so"])]
    assert ordered == [names[3], names[2], names[1], names[4], names[5], names[0]]


def test_named_library_and_own_folder_lead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = make_library(tmp_path / "env" / "llvm", "libLLVM.so.19.1")
    named = make_library(tmp_path, "libLLVM-14.so")
    system = make_library(tmp_path / "system", "libLLVM.so.21.0")
    monkeypatch.setattr(llvm, "system_patterns", lambda: iter([(tmp_path / "system", "libLLVM*")]))
    monkeypatch.setattr(llvm.sys, "platform", "linux")
    monkeypatch.setenv(llvm.LLVM_VARIABLE, str(named))
    monkeypatch.setattr(llvm.sys, "prefix", str(tmp_path / "env"))
    assert llvm.llvm_candidates() == [named, own, system]
    assert llvm.companions(system) == []


@linux
@pytest.mark.usefixtures("no_other")
def test_aborting_library_is_survived_and_the_next_one_taken(tmp_path: Path, monkeypatch) -> None:
    bad = make_library(tmp_path / "lib", "libLLVM.so.20.1")
    good = make_library(tmp_path / "lib", "libLLVM.so.19.1")
    abort = 'case "$DRJIT_LIBLLVM_PATH" in *20.1) kill -ABRT $$;; esac'
    python = fake_python(tmp_path / "bin", f"echo {probe.IMPORTED}; {abort}; echo {probe.PASSED}")
    monkeypatch.setattr(llvm.sys, "executable", str(python))
    assert llvm.find_llvm() == good
    assert starts(python) == [str(bad), str(good)]
    assert llvm.find_llvm() == good
    assert len(starts(python)) == 2, "verdicts are remembered"
    os.utime(good, ns=(1, 1))
    llvm.find_llvm()
    assert starts(python)[2:] == [str(good)], "a changed library is tried again"


@linux
@pytest.mark.usefixtures("no_other")
def test_no_working_library_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = make_library(tmp_path / "lib", "libLLVM.so.18.1")
    python = fake_python(tmp_path / "bin", f"echo {probe.IMPORTED}; kill -ABRT $$")
    monkeypatch.setattr(llvm.sys, "executable", str(python))
    monkeypatch.setattr(llvm.platform, "freedesktop_os_release", lambda: {"ID": "debian"})
    caught = error_of(llvm.find_llvm)
    assert caught.code == "llvm-missing"
    assert str(bad) in caught.text and "signal 6" in caught.text
    assert "apt-get install libllvm19" in caught.remedy
    # Kills and missing packages are no verdict on the library.
    bad.write_bytes(b"another")
    python = fake_python(tmp_path / "bin", f"echo {probe.IMPORTED}; kill -KILL $$")
    for count in (2, 3):
        assert "signal 9" in str(error_of(llvm.find_llvm))
        assert len(starts(python)) == count
    python = fake_python(tmp_path / "bin", 'echo "ModuleNotFoundError: No module named mitsuba"; exit 1')
    assert error_of(llvm.find_llvm).code == "package-missing"


def test_unusable_cache_costs_nothing_but_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("FIPT_CACHE", str(blocked))
    assert llvm.remembered("key", lambda: llvm.Verdict(True, "")).works
    monkeypatch.setenv("FIPT_CACHE", str(tmp_path))
    (tmp_path / "devices.json").write_text("{damaged")
    assert llvm.remembered("key", lambda: llvm.Verdict(True, "")).works
    assert json.loads((tmp_path / "devices.json").read_text())["key"]["works"] is True


def test_real_library_is_found_and_wrong_ones_refused(tmp_path: Path) -> None:
    library = llvm.find_llvm()
    assert llvm.try_variant("llvm_ad_rgb", library).works
    verdict = llvm.try_variant("llvm_ad_rgb", make_library(tmp_path, "libLLVM.so.19.1"))
    assert not verdict.works and verdict.reason


def test_variant_is_set_once_and_bad_devices_are_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    current = variant.set_variant("llvm")
    assert current == "llvm_ad_rgb"
    assert variant.set_variant("auto") == variant.set_variant("llvm") == current
    assert variant.torch_device() == "cpu"
    assert error_of(variant.set_variant, "tpu").code == "setting-invalid"
    monkeypatch.setattr(variant, "cuda_driver_version", lambda: None)
    caught = error_of(variant.set_variant, "cuda")
    assert caught.code == "cuda-missing" and "driver" in caught.text


def test_engine_starts_isolated_from_any_folder(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("raise SystemExit('the working directory reached the engine')")
    command = interpreter.engine_command(PYTHON, "--help")
    environment = interpreter.engine_environment(PYTHON)
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert result.returncode == 0 and result.stdout == "" and "estimate" in result.stderr


@linux
def test_engine_python_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(interpreter.PYTHON_VARIABLE, raising=False)
    monkeypatch.setattr(interpreter, "PACKAGE_FOLDER", tmp_path / "no" / "checkout")
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "data"))
    assert interpreter.find_engine_python() == PYTHON
    assert interpreter.find_engine_python(str(PYTHON)) == PYTHON
    assert interpreter.find_engine_python(managed=[PYTHON.parent.parent]) == PYTHON
    monkeypatch.setenv(interpreter.PYTHON_VARIABLE, str(tmp_path / "gone"))
    caught = error_of(interpreter.find_engine_python)
    assert caught.code == "engine-missing" and interpreter.PYTHON_VARIABLE in caught.text
    assert interpreter.find_engine_python(str(PYTHON)) == PYTHON, "an argument comes first"
    # One without packages is refused.
    monkeypatch.delenv(interpreter.PYTHON_VARIABLE)
    bare = fake_python(tmp_path / "bin", 'echo "3.11.0 lacks mitsuba"; exit 1')
    assert "lacks mitsuba" in str(error_of(interpreter.find_engine_python, str(bare)))
    monkeypatch.setattr(interpreter.sys, "executable", str(bare))
    caught = error_of(interpreter.find_engine_python)
    assert caught.code == "engine-missing" and interpreter.PYTHON_VARIABLE in caught.remedy


def test_engine_environment_is_clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP"):
        monkeypatch.setenv(name, "/nowhere")
    monkeypatch.setenv(llvm.LLVM_VARIABLE, "/a/libLLVM.so")
    (tmp_path / "system").mkdir()
    monkeypatch.delenv(interpreter.BLENDER_VARIABLE, raising=False)
    monkeypatch.delitem(sys.modules, "bpy", raising=False)
    environment = interpreter.engine_environment(tmp_path / "bin" / "python")
    assert interpreter.BLENDER_VARIABLE not in environment, "this Python has no Blender to offer"
    assert not [name for name in environment if name.startswith("PYTHON")]
    assert environment[llvm.LLVM_VARIABLE] == "/a/libLLVM.so"
    if sys.platform == "linux":
        assert environment["LD_LIBRARY_PATH"].split(":")[0] == str(tmp_path / "system")


def test_mitsuba_before_the_variant_is_an_error() -> None:
    # Dr.Jit looks for LLVM at Mitsuba's import: one that is not the tried one aborts processes later.
    script = "import mitsuba\nfrom fipt_blender.core.device.variant import set_variant\nset_variant('llvm')\n"
    environment = {key: value for key, value in os.environ.items() if key != llvm.LLVM_VARIABLE}
    command = [sys.executable, "-c", script]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 1 and "imported before set_variant" in result.stderr
