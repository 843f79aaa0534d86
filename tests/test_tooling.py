# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""dev.py: the extension's zip, a release, pins, set-up that runs only once."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

from fipt_blender.bridge import pins, provision
from fipt_blender.bridge.places import environment_python
from samples.development import load_dev

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def dev() -> ModuleType:
    return load_dev()


def test_a_release_has_the_zip_of_the_extension_its_checksum_and_notes(dev: ModuleType, tmp_path: Path) -> None:
    version = dev.read_versions()["CHANGELOG.md"]
    with pytest.raises(dev.SetupError, match=version):
        dev.release(f"{version}", tmp_path)
    assert dev.release(f"v{version}", tmp_path) == 0
    checksum, name = (tmp_path / "SHA256SUMS").read_text(encoding="utf-8").split()
    assert checksum == hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
    notes = (tmp_path / "NOTES.md").read_text(encoding="utf-8")
    assert notes.startswith("### ") and "\n## " not in notes
    assert notes.strip() in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    with zipfile.ZipFile(tmp_path / name) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        written = json.loads(archive.read(pins.PINS_NAME))
    groups = pins.read_pins()
    assert written == {name: groups[name] for name in pins.ENGINE_GROUPS}
    assert (tmp_path / name).stat().st_size < 4.5e6, "the heavy packages live in the engine's environment"
    assert name == f"fipt_blender-{manifest['version']}.zip"
    assert {"__init__.py", "__main__.py", "LICENSE", "core/__main__.py", "cli/__init__.py"} <= set(names)
    assert names == sorted(names)
    foreign = ("tests", "examples", "benchmarks", "fipt_blender", "dist", "out")
    for each in names:
        assert "__pycache__" not in each and not each.endswith(".pyc") and not each.startswith(".")
        assert each.split("/")[0] not in foreign
    assert dev.build_extension(tmp_path / "again").read_bytes() == (tmp_path / name).read_bytes()


def test_the_index_offers_the_zip_to_blender(dev: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import bpy

    monkeypatch.setattr(dev, "VENV", Path(bpy.utils.resource_path("LOCAL")))
    monkeypatch.setattr(dev, "VENV_PYTHON", Path(sys.executable))
    assert dev.index_extensions(tmp_path) == 0
    (entry,) = json.loads((tmp_path / "index.json").read_text(encoding="utf-8"))["data"]
    archive = tmp_path / entry["archive_url"]
    assert entry["id"] == "fipt_blender" and entry["version"] in archive.name
    assert entry["archive_hash"] == "sha256:" + hashlib.sha256(archive.read_bytes()).hexdigest()
    assert (tmp_path / "index.html").is_file()


def test_build_refuses_versions_that_disagree(dev: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", dev.read_versions()["pyproject.toml"])
    versions = {"blender_manifest.toml": "0.1.0", "pyproject.toml": "0.2.0"}
    monkeypatch.setattr(dev, "read_versions", lambda: versions)
    with pytest.raises(dev.SetupError, match=r"0\.2\.0"):
        dev.build_extension(tmp_path)
    assert not list(tmp_path.iterdir())


def test_every_pin_is_exact() -> None:
    groups = pins.read_pins()
    assert set(groups) == {"blender", "dev", "cluster", "heif", "markers", *pins.ENGINE_GROUPS}
    for requirement in (pins.without_hashes(pin) for group in groups.values() for pin in group):
        assert re.match(r"[A-Za-z0-9-]+==[0-9][0-9a-z.]*( ?;|$)", requirement), requirement


def test_the_lock_has_every_pin_of_the_engine_and_hashes_of_all() -> None:
    """After a change of a pin: python3 dev.py lock."""
    groups = pins.read_pins()
    for line in (*groups["lock"], *groups["pip"], *groups["llvm"]):
        assert re.search(r" --hash=sha256:[0-9a-f]{64}( |$)", line), line
    names: dict[str, list[str]] = {}
    for line in groups["lock"]:
        names.setdefault(re.split("[=; ]", line)[0].lower(), []).append(re.search(r"==([^ ;]+)", line).group(1))
    for pin in groups["engine"]:
        name, _, version = pin.partition(";")[0].strip().partition("==")
        if name != "torch":
            assert version in names[name.lower()], f"{pin}: run python3 dev.py lock"
    assert not {"torch", "triton"} & set(names) and not any(name.startswith("nvidia") for name in names)
    assert not {"pip", "karellen-llvm-core"} & set(names), "set-up itself checks these"
    assert len(names) >= 20


def test_set_up_is_done_once_and_again_when_something_changed(dev: ModuleType, tmp_path: Path) -> None:
    groups = {"engine": ["torch==1"]}
    key = dev.setup_key(groups, tmp_path)
    assert key == dev.setup_key(groups, tmp_path)
    assert key != dev.setup_key({"engine": ["torch==2"]}, tmp_path)
    assert key != dev.setup_key(groups, tmp_path / "moved")
    stamp, python, library = tmp_path / "setup.json", environment_python(tmp_path), tmp_path / "libLLVM.so"
    assert not pins.is_set_up(tmp_path, key)
    python.parent.mkdir()
    for file in (python, library):
        file.touch()
    whole = {"key": key, "installed": True, "complete": True, "llvm": str(library)}
    for content in (json.dumps({**whole, "complete": False}), "{"):
        stamp.write_text(content)
        assert not pins.is_set_up(tmp_path, key)
    stamp.write_text(json.dumps(whole))
    assert pins.is_set_up(tmp_path, key) and not pins.is_set_up(tmp_path, "other")
    library.unlink()
    assert not pins.is_set_up(tmp_path, key)


def test_unsupported_python_is_named(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dev, "SUPPORTED_PYTHONS", ((2, 7),))
    monkeypatch.setattr(dev, "other_python", lambda: None)
    assert dev.main(["test"]) == 1
    assert "Python 2.7 is needed" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_exit_status_of_the_child_is_passed_on(dev: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dev, "VENV_PYTHON", Path(sys.executable))
    assert dev.call("-c", "raise SystemExit(7)") == 7
    assert dev.call("-c", "import os; os.kill(os.getpid(), 6)") == 134


def test_wheel_libraries_takes_shared_libraries_only(tmp_path: Path) -> None:
    wheel = tmp_path / "a.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("x.data/data/lib/libLLVM.so.23.1", b"\x7fELF library")
        archive.writestr("x.data/data/lib/deep/libc++.so", b"INPUT(libc++.so.1)")
        archive.writestr("x.data/data/lib/libLTO.so.23.1", b"\x7fELF other")
        archive.writestr("x.data/data/lib/libLLVM.a", b"\x7fELF archive")
    written = provision.wheel_libraries(wheel, tmp_path / "llvm", ("libLLVM", "libc++"))
    assert written == [tmp_path / "llvm" / "libLLVM.so.23.1"]
    assert written[0].read_bytes() == b"\x7fELF library"


@pytest.mark.skipif(sys.platform == "win32", reason="symbolic links")
def test_copy_libraries_keeps_each_name_and_stays_inside_the_tree(tmp_path: Path) -> None:
    lib = tmp_path / "root" / "usr" / "lib"
    (lib / "llvm").mkdir(parents=True)
    (lib / "llvm" / "libLLVM.so.1").write_bytes(b"a")
    (lib / "libLLVM.so.19.1").symlink_to("/usr/lib/llvm/libLLVM.so.1")
    (lib / "libz3.so.4").symlink_to("libz3.so.4.8")
    (lib / "libz3.so.4.8").write_bytes(b"z")
    (lib / "libgone.so.1").symlink_to("/usr/lib/gone")
    provision.copy_libraries(tmp_path / "root", tmp_path / "out")
    contents = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    llvm = {"libLLVM.so.1": b"a", "libLLVM.so.19.1": b"a"}
    assert contents == {**llvm, "libz3.so.4": b"z", "libz3.so.4.8": b"z"}
