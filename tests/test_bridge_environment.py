"""The engine's environment: pip's output, a real set-up from a folder of wheels, and set-up as a child process."""

from __future__ import annotations

import ensurepip
import errno
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections import namedtuple
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
from pytest import MonkeyPatch

from fipt_blender.bridge import environment, interpreter, native, pins, places, setup
from fipt_blender.bridge.pip import PipProgress, pip_error
from fipt_blender.bridge.plan import Plan
from fipt_blender.bridge.torch_build import TORCH_INDEX, Size, choose_torch_build, torch_index, torch_requirement
from fipt_blender.core.device.cuda import Gpu
from fipt_blender.core.run.errors import FiptError, problem
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.runfolder import RunFolder
from samples.refusals import error_of
from samples.wheels import make_wheel, site_packages

PYTHON = Path(sys.executable)
HERE = sys.version_info[:2]
NO_MATCH = "ERROR: No matching distribution found for torch"


class Listener:
    """Records the progress of set-up."""

    def __init__(self) -> None:
        self.stages, self.fractions, self.warnings = [], [], []
        self.progress = self.fractions.append
        self.detail = self.log = lambda text: None

    def stage(self, name: str, text: str) -> None:
        self.stages.append(name)

    def warning(self, key: str, /, **values: object) -> None:
        self.warnings.append(problem(key, **values).code)


def make_plan(tmp_path: Path, **changes: object) -> Plan:
    values = {
        "folder": tmp_path / "env",
        "base": PYTHON,
        "requirements": ["fipttiny==1.0"],
        "modules": ("fipttiny",),
        "wheels": tmp_path / "wheels",
        "key": "k",
    }
    return Plan(**{**values, **changes})


def locked(wheel: Path, digest: str = "") -> str:
    """The line of a lock for a wheel, with its own hash by default."""
    name, version = wheel.name.split("-")[:2]
    return f"{name}=={version} --hash=sha256:{digest or hashlib.sha256(wheel.read_bytes()).hexdigest()}"


@pytest.fixture(scope="module")
def child(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Set-up of an installed extension as a child process, with pip and one tiny pinned package: what it said
    (`first`), the folder and stamp of the environment, and what a second one said while somebody else was at work.
    """
    folder = tmp_path_factory.mktemp("child")
    package, data, wheels = folder / "extension", folder / "data", folder / "wheels"
    shutil.copytree(places.PACKAGE_FOLDER, package, ignore=shutil.ignore_patterns("__pycache__"))
    # named as the engine's main package, by which the wheels' Python is recognised
    wheel = make_wheel(wheels, "mitsuba", "0.0.1")
    wheel.rename(wheel.with_name(f"mitsuba-0.0.1-cp{HERE[0]}{HERE[1]}-none-any.whl"))
    bundled = next((Path(ensurepip.__file__).parent / "_bundled").glob("pip-*.whl"))
    groups = {"engine": ["mitsuba==0.0.1"], "llvm": [], "pip": [locked(Path(shutil.copy(bundled, wheels)))]}
    (package / pins.PINS_NAME).write_text(json.dumps(groups))
    command = interpreter.setup_command(PYTHON, data, "auto", wheels)
    command = [part.replace(str(places.PACKAGE_FOLDER), str(package)) for part in command]
    first = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    (environment,) = pins.environments(data)
    with hold(RunFolder(data), ["set-up"]):
        second = subprocess.run(command, capture_output=True, text=True)
    return SimpleNamespace(first=first, folder=environment, stamp=pins.read_stamp(environment), second=second)


@pytest.fixture(scope="module")
def bare(child: SimpleNamespace) -> Path:
    """An environment with pip alone, that of `child` without its package; it takes seconds."""
    for path in site_packages(child.folder).rglob("*mitsuba*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    (child.folder / pins.STAMP_NAME).unlink()
    return child.folder


@pytest.fixture
def made(bare: Path, tmp_path: Path) -> None:
    """The environment of `make_plan` is there, and set-up does not make it anew; it has no packages yet."""
    shutil.copytree(bare, tmp_path / "env", symlinks=True, copy_function=os.link)
    (tmp_path / "env" / pins.STAMP_NAME).write_text(json.dumps({"installed": True}))


@pytest.fixture
def quick_venv(bare: Path, monkeypatch: MonkeyPatch) -> None:
    """Python's venv copies the environment of `bare` instead of making one."""
    run = environment.run_quietly

    def copied(command: list[str], *arguments: Path) -> subprocess.CompletedProcess:
        if "venv" in command:
            shutil.copytree(bare, command[-1], symlinks=True, copy_function=os.link)
        return subprocess.CompletedProcess(command, 0) if "-m" in command else run(command, *arguments)

    monkeypatch.setattr(environment, "run_quietly", copied)


@pytest.fixture
def without_ensurepip(monkeypatch: MonkeyPatch) -> None:
    """A Python as Debian's without python3-venv: venv works only without pip."""
    run = environment.run_quietly

    def refused(command: list[str], *arguments: Path) -> subprocess.CompletedProcess:
        if "ensurepip" in command:
            return subprocess.CompletedProcess(command, 1, "", "No module named ensurepip")
        return run(command, *arguments)

    monkeypatch.setattr(environment, "run_quietly", refused)


@pytest.fixture(autouse=True)
def device_works(monkeypatch: MonkeyPatch) -> None:
    """Replace the engine's check by one that finds an LLVM, as these environments contain no engine."""
    found = {"device": "llvm", "llvm": None}
    monkeypatch.setattr(native, "check_engine", lambda python: (found, FiptError.of("", "", "")))


@pytest.mark.parametrize(
    ("lines", "wheels", "code"),
    [
        (["ERROR: Could not install packages due to an OSError: [Errno 28] No space left"], None, "disk-full"),
        (["WARNING: Retrying after 'NewConnectionError(...)'", NO_MATCH], None, "network-missing"),
        ([NO_MATCH], None, "packages-failed"),
        ([NO_MATCH], Path("/wheels"), "wheels-missing"),
        ([], None, "packages-failed"),
    ],
)
def test_pips_failures_have_words(lines: list[str], wheels: Path | None, code: str) -> None:
    progress = PipProgress(1.0, Listener())
    for line in lines:
        progress.line(line)
    error = pip_error(progress, wheels)
    assert error.code == code and error.text and error.remedy


def test_set_up_from_wheels_is_complete_resumed_and_remade(tmp_path: Path, quick_venv: None) -> None:
    make_wheel(tmp_path / "wheels", "fipttiny", "1.0")
    plan = make_plan(tmp_path)
    (tmp_path / "env").mkdir()
    (tmp_path / "env" / "half-made").touch()  # an earlier set-up was killed here
    listener = Listener()
    environment.set_up(plan, listener)
    assert listener.stages == ["environment", "packages", "libraries", "llvm"]
    assert pins.is_set_up(plan.folder, "k") and not (plan.folder / "half-made").exists()
    answer = subprocess.run(
        [str(plan.python), "-I", "-c", "import fipttiny; print(fipttiny.VALUE)"], capture_output=True
    )
    assert answer.stdout.strip() == b"7"
    # what is there is kept: a second time nothing is made anew
    marker = plan.folder / "marker"
    marker.touch()
    environment.set_up(plan, Listener())
    assert marker.exists()
    # an interpreter that is gone (Blender was updated) has it made anew
    plan.python.unlink()
    environment.make_environment(plan)
    assert not marker.exists() and plan.python.exists()


def test_set_up_names_what_the_wheels_lack_and_a_package_that_breaks(tmp_path: Path, quick_venv: None) -> None:
    make_wheel(tmp_path / "wheels", "fipttiny", "0.9")
    caught = error_of(environment.set_up, make_plan(tmp_path), Listener())
    assert caught.code == "wheels-missing" and "fipttiny==1.0" in caught.text
    assert not pins.read_stamp(tmp_path / "env").installed
    (tmp_path / "env" / pins.STAMP_NAME).write_text(json.dumps({"installed": True}))  # spares making it anew
    make_wheel(tmp_path / "wheels", "fipttiny", "1.0", "raise ImportError('no libfoo')")
    caught = error_of(environment.set_up, make_plan(tmp_path), Listener())
    assert caught.code == "package-broken" and "no libfoo" in caught.text
    stamp = pins.read_stamp(tmp_path / "env")
    assert stamp.installed and not stamp.complete, "mended, it is completed and not made anew"


@pytest.mark.usefixtures("without_ensurepip")
@pytest.mark.parametrize("source", ["usual", "find-links", "index", "none"])
def test_python_without_pip_downloads_the_pinned_one(source: str, tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    """From where the user's pip would take it, or from the usual place."""
    install = "import sys, sysconfig, zipfile\nzipfile.ZipFile(sys.argv[-1]).extractall(sysconfig.get_path('purelib'))"
    wheel = make_wheel(tmp_path / "index", "pip", "1.0", install, "pip/__main__.py")
    usual = wheel.parent if source == "usual" else tmp_path / "none"
    monkeypatch.setattr(environment, "PIP_WHEELS", usual.as_uri())
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    if source == "find-links":
        (tmp_path / "pip.conf").write_text(f"[install]\nfind-links =\n  {tmp_path}/none\n  {wheel.parent}\n")
    if source == "index":
        (tmp_path / "simple").mkdir()
        wheel.parent.rename(tmp_path / "simple" / "pip")
        handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
        server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/simple/"
        (tmp_path / "pip.conf").write_text(f"[global]\nindex-url = {address}\n")
        wheel = tmp_path / "simple" / "pip" / wheel.name
    plan = make_plan(tmp_path, wheels=None, pip=(locked(wheel),))
    if source == "none":
        caught = error_of(environment.make_environment, plan)
        assert caught.code == "python-unfit" and "No module named ensurepip" in caught.text
        assert not plan.folder.exists()
        return
    environment.make_environment(plan)
    assert (site_packages(plan.folder) / "pip").is_dir()


@pytest.mark.usefixtures("without_ensurepip")
def test_a_pip_of_anothers_making_never_runs(tmp_path: Path) -> None:
    """It would vouch for whatever it installs. Refused with the pinned version, and passed over with another one."""
    forged = make_pip(tmp_path, "0.1")
    caught = error_of(environment.make_environment, make_plan(tmp_path, pip=(locked(forged, "0" * 64),)))
    assert caught.code == "package-hash" and "pip-0.1" in caught.text and caught.remedy
    other = make_plan(tmp_path, pip=(f"pip==0.2 --hash=sha256:{'0' * 64}",))
    assert error_of(environment.make_environment, other).code == "python-unfit"
    assert not (tmp_path / "ran").exists() and not other.folder.exists()


def make_pip(tmp_path: Path, version: str) -> Path:
    """The wheel of a forged pip, which makes the file "ran" when its code runs."""
    code = f"open({str(tmp_path / 'ran')!r}, 'w')\n"
    return make_wheel(tmp_path / "wheels", "pip", version, code, "pip/__main__.py")


def test_locked_packages_are_installed_only_with_the_hashes_of_the_lock(tmp_path: Path, made: None) -> None:
    tiny = make_wheel(tmp_path / "wheels", "fipttiny", "1.0")
    other = make_wheel(tmp_path / "wheels", "fiptother", "2.0")
    lock = (locked(tiny), locked(other, "0" * 64))
    caught = error_of(environment.set_up, make_plan(tmp_path, lock=lock), Listener())
    assert caught.code == "package-hash" and "fiptother" in caught.text
    listener = Listener()
    environment.set_up(make_plan(tmp_path, lock=(locked(tiny), locked(other))), listener)
    packages = site_packages(tmp_path / "env")
    assert (packages / "fipttiny.py").exists() and (packages / "fiptother.py").exists()
    assert listener.fractions == sorted(listener.fractions)


def test_llvm_is_unpacked_only_with_the_hash_of_the_lock(tmp_path: Path, monkeypatch: MonkeyPatch, made: None) -> None:
    missing = FiptError.of("llvm-missing", "No LLVM.", "Install one.")
    library = tmp_path / "env" / "llvm" / "libLLVM.so.19"
    found = {"device": "llvm", "llvm": str(library)}
    monkeypatch.setattr(native, "check_engine", lambda python: (found if library.exists() else {}, missing))
    wheel = make_wheel(tmp_path / "wheels", "fiptllvm", "1.0", "\x7fELF", "lib/libLLVM.so.19")
    for pin, code in ((locked(wheel, "0" * 64), "package-hash"), ("fiptllvm==1.0", "llvm-missing")):
        caught = error_of(native.provide_llvm, make_plan(tmp_path, llvm=(pin,)), Listener())
        assert caught.code == code and caught.remedy and not library.exists()
    assert native.provide_llvm(make_plan(tmp_path, llvm=(locked(wheel),)), Listener()) == str(library)


def test_a_source_archive_is_never_built(tmp_path: Path, made: None) -> None:
    (tmp_path / "wheels").mkdir()
    with tarfile.open(tmp_path / "wheels" / "fipttiny-1.0.tar.gz", "w:gz") as archive:
        code = f"open({str(tmp_path / 'ran')!r}, 'w')".encode()
        info = tarfile.TarInfo("fipttiny-1.0/setup.py")
        info.size = len(code)
        archive.addfile(info, io.BytesIO(code))
    caught = error_of(environment.set_up, make_plan(tmp_path), Listener())
    assert caught.code == "wheels-missing" and not (tmp_path / "ran").exists()


def test_the_package_indexs_build_takes_the_place_of_one_that_cant_be_reached(
    tmp_path: Path, monkeypatch: MonkeyPatch, made: None
) -> None:
    wheels = tmp_path / "wheels"
    tiny, _ = make_wheel(wheels, "fipttiny", "1.0"), make_wheel(wheels, "torch", "1.0")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(wheels))
    values = {"requirements": ["fipttiny==1.0", "torch==1.0"], "lock": (locked(tiny),), "wheels": None}
    listener = Listener()
    environment.set_up(make_plan(tmp_path, torch="cpu", **values), listener)
    assert listener.warnings == ["torch-index"]
    packages = site_packages(tmp_path / "env")
    assert (packages / "torch.py").exists() and (packages / "fipttiny.py").exists()


def test_little_space_is_seen_beforehand(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")

    def check(free: int, wheels: Path | None, build: str) -> Listener:
        monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(free, 0, free))
        listener = Listener()
        environment.check_space(make_plan(tmp_path, wheels=wheels), build, listener)
        return listener

    for free, build in ((1_000_000_000, ""), (1_000_000_000, "cpu"), (7_000_000_000, "cu130")):
        monkeypatch.setattr(shutil, "disk_usage", lambda path, free=free: usage(free, 0, free))
        caught = error_of(environment.set_up, make_plan(tmp_path, wheels=None, torch=build), Listener())
        assert caught.code == "disk-full" and f"{free // 10**9}.0 GB are free" in caught.text
        assert not (tmp_path / "env").exists()
    # the package index's own build may be the small one
    monkeypatch.setitem(environment.SIZES, "", Size(3.0, 9.0))
    assert check(7_000_000_000, None, "").warnings == ["disk-full"]
    assert check(9_100_000_000, None, "").warnings == []
    # a folder's wheels are known: of two versions the larger one counts, unpacked
    wheels = tmp_path / "wheels"
    for version, megabytes in (("1.0", 1), ("1.1", 2)):
        code = "#" * 1_000_000 * megabytes
        assert make_wheel(wheels, "fipttiny", version, code).stat().st_size > megabytes * 1_000_000
    (wheels / "broken-1.0-py3-none-any.whl").write_bytes(b"0" * 500_000)
    assert check(2_502_000, wheels, "").warnings == []
    assert error_of(check, 2_500_000, wheels, "").code == "disk-full"


def test_plans_prefer_what_stands_and_name_a_python_that_is_missing(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
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


def test_child_process_tells_in_messages_and_says_what_is_missing(child: SimpleNamespace) -> None:
    messages = [parse_message(line) for line in child.first.stdout.splitlines()]
    assert None not in messages, "nothing but messages on stdout"
    names = [message["name"] for message in messages if message["type"] == "stage"]
    assert list(dict.fromkeys(names)) == ["environment", "packages", "libraries"]
    fractions = [message["fraction"] for message in messages if message["type"] == "progress"]
    assert fractions == sorted(fractions)
    # the only pinned package is installed; the engine's others are missed
    assert child.first.returncode == 1 and messages[-1]["code"] == "package-broken"
    assert "torch" in messages[-1]["text"] and "pip install" in child.first.stderr
    assert child.stamp.installed and not child.stamp.complete
    # a second set-up in one data folder waits its turn
    error = parse_message(child.second.stdout.splitlines()[-1])
    assert child.second.returncode == 1 and error["code"] == "run-busy"


def test_data_folder_is_the_platforms(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    monkeypatch.delenv(places.DATA_VARIABLE, raising=False)
    for platform, variable in (("linux", "XDG_DATA_HOME"), ("win32", "LOCALAPPDATA")):
        monkeypatch.setattr(sys, "platform", platform)
        monkeypatch.setenv(variable, str(tmp_path / platform))
        assert places.default_data_folder() == tmp_path / platform / "fipt_blender"
    monkeypatch.setenv(places.DATA_VARIABLE, str(tmp_path / "named"))
    assert places.default_data_folder() == tmp_path / "named"


def test_run_folders_are_fresh_and_safely_named(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    first, second = (places.new_run_folder(tmp_path / "runs", "../Living room: 2?") for _ in range(2))
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
    device: str, driver: int | None, gpus: list[Gpu], linux: str, windows: str, monkeypatch: MonkeyPatch
) -> None:
    for platform, expected in (("linux", linux), ("win32", windows)):
        monkeypatch.setattr(sys, "platform", platform)
        assert choose_torch_build(device, driver, gpus) == expected


def test_torch_requirement_names_the_build() -> None:
    requirements = ["a==1", "torch==2.13.0; python_version > '3'"]
    assert torch_requirement(requirements, "cu126") == "torch==2.13.0+cu126; python_version > '3'"
    assert torch_requirement(requirements, "") == torch_requirement(["a==1"], "cpu") == ""
    assert torch_index("cu126") == f"{TORCH_INDEX}/cu126" and torch_index("") == ""
