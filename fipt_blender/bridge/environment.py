# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Making the engine's environment: a virtual environment, the pinned packages, system libraries, an LLVM.

One code path for dev.py and for the add-on (`bridge.setup`). Standard library only.
"""

from __future__ import annotations

import json
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.job.errors import FiptError
from ..core.job.messages import parse_message
from ..core.job.runfolder import explained_write_errors, write_json
from . import pins, provision
from .interpreter import engine_command, engine_environment, system_folder
from .pip import PipProgress, Teller, pip_error, progress_bar, run_pip
from .places import environment_python, site_packages
from .torch_build import SIZES, torch_index, torch_requirement

ENGINE_MODULES = ("mitsuba", "torch", "OpenEXR", "pycolmap", "pyoidn")
LLVM_LIBRARIES = ("libLLVM", "libc++", "libunwind")
_DEBIAN_WHEELS = Path("/usr/share/python-wheels")
_VERSION = "import sys; print(*sys.version_info[:2])"
_PIP_INSIDE = "import pip, sys; print(*sys.version_info[:2])"
_PIP_VERSION = "import pip; print(pip.__version__)"
_BUNDLED = "import ensurepip, pathlib; print(*pathlib.Path(ensurepip.__file__).parent.rglob('pip-*.whl'))"


@dataclass(frozen=True)
class Plan:
    """What an environment shall be.

    Attributes:
        folder: where it lies; its parent need not exist.
        base: the interpreter that it is made with.
        requirements: the pinned packages.
        modules: which to import in the end, each in a process of its own, to see that they load.
        llvm: the package that LLVM is taken out of where the machine has none.
        pip: pin of pip itself.
        key: what the requirements depend on; another key makes set-up start again.
        wheels: folder to install from, None for the network.
        torch: PyTorch's build, of `torch_build.SIZES`; "" takes the package index's own.
    """

    folder: Path
    base: Path
    requirements: Sequence[str]
    modules: Sequence[str] = ENGINE_MODULES
    llvm: Sequence[str] = ()
    pip: Sequence[str] = ()
    key: str = ""
    wheels: Path | None = None
    torch: str = ""

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return environment_python(self.folder)


def set_up(plan: Plan, tell: Teller) -> None:
    """Make or complete an environment; one that stands is left alone but for a look at its packages.

    Raises:
        FiptError: what is wrong and what to do.
    """
    check_space(plan, plan.torch, tell)
    tell.stage("environment", "Making the Python environment")
    make_environment(plan)
    tell.stage("packages", "Looking up the packages")
    install(plan, tell)
    _stamp(plan, complete=False, llvm=None)
    tell.stage("libraries", "Looking for system libraries")
    provide_system_libraries(plan, tell)
    tell.stage("llvm", "Trying the devices")
    _stamp(plan, complete=True, llvm=provide_llvm(plan, tell))


def _stamp(plan: Plan, complete: bool, llvm: str | None) -> None:
    stamp = {"key": plan.key, "installed": True, "complete": complete, "llvm": llvm, "torch": plan.torch}
    write_json(plan.folder / pins.STAMP_NAME, stamp)


def check_space(plan: Plan, build: str, tell: Teller) -> None:
    """See beforehand whether the disk has room for an environment with a build of PyTorch.

    Which build the package index itself gives is not known before: there, too little space for a large one
    is a warning.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    if pins.read_stamp(plan.folder).get("installed"):
        return
    with explained_write_errors(plan.folder):
        plan.folder.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(plan.folder.parent).free / 1e9
    expected = pins.unpacked_gb(plan.wheels) if plan.wheels else SIZES[build].disk_gb
    least = expected if plan.wheels or build else SIZES["cpu"].disk_gb
    place = f"in {plan.folder.parent}, and {free:.1f} GB are free."
    remedy = "Free some space, or choose a data folder on another disk."
    if free < least:
        raise FiptError("disk-full", f"The packages need {least:.1f} GB {place}", remedy)
    if free < expected:
        tell.warning("disk-full", f"The packages may need {expected:.1f} GB {place}", remedy)


def make_environment(plan: Plan) -> None:
    """Make the virtual environment, also where Python lacks ensurepip (Debian without python3-venv).

    One that an earlier, unfinished set-up left is made anew: what it lacks can't be told, and pip's cache
    has the downloads.

    Raises:
        FiptError: ``python-unfit``.
    """
    folder, python = plan.folder, plan.python
    wanted = _answer(plan.base, _VERSION)
    if wanted is None:
        raise FiptError("python-unfit", f"{plan.base} does not start.", "Name another Python.")
    if folder.exists():
        fits = _answer(python, _PIP_INSIDE) == wanted
        if fits and pins.read_stamp(folder).get("installed"):
            return
        shutil.rmtree(folder, ignore_errors=True)
    if _quiet([str(plan.base), "-I", "-m", "venv", str(folder)]).returncode == 0:
        return
    shutil.rmtree(folder, ignore_errors=True)
    result = _quiet([str(plan.base), "-I", "-m", "venv", "--without-pip", str(folder)])
    if result.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        raise FiptError(
            "python-unfit",
            f"{plan.base} can't make a virtual environment: {_said(result)}",
            "Install Python's venv module (Debian, Ubuntu: apt-get install python3-venv), or another Python.",
        )
    for give_pip in (_pip_from_wheels, _pip_from_pythons, _pip_from_debian):
        if give_pip(plan) and _answer(python, _PIP_INSIDE) is not None:
            return
    shutil.rmtree(folder, ignore_errors=True)
    raise FiptError(
        "python-unfit",
        f"The Python {plan.base} can't install packages: it has neither pip nor ensurepip.",
        "Install them (Debian, Ubuntu: apt-get install python3-venv), or install another Python, and set up"
        " again.",
    )


def _install_wheel(plan: Plan, wheel: Path) -> bool:
    """A wheel of pip installs itself."""
    command = [str(plan.python), f"{wheel}/pip", "install", "--no-index", "--no-deps", str(wheel)]
    return _quiet(command).returncode == 0


def _pip_from_wheels(plan: Plan) -> bool:
    folders = [folder for folder in (plan.wheels, _DEBIAN_WHEELS) if folder is not None]
    return any(
        _install_wheel(plan, wheel) for folder in folders for wheel in sorted(folder.glob("pip-*.whl"))
    )


def _pip_from_pythons(plan: Plan) -> bool:
    """The wheel of pip that other Pythons of this machine bring, the newest first."""
    for python in other_pythons():
        for wheel in (_answer(python, _BUNDLED) or "").split():
            if _install_wheel(plan, Path(wheel)):
                return True
    return False


def _pip_from_debian(plan: Plan) -> bool:
    if plan.wheels is not None:  # without network, then
        return False
    with provision.DebianPackages() as debian:
        root = debian.unpack(["python3-pip-whl"]) if debian.available else None
        wheel = next(root.rglob("pip-*.whl"), None) if root else None
        return wheel is not None and _install_wheel(plan, wheel)


def other_pythons() -> Iterator[Path]:
    """Pythons on the search path that the engine can run in, the newest first."""
    for version in sorted(pins.ENGINE_PYTHONS, reverse=True):
        names = [f"python{version[0]}.{version[1]}", "python3", "python"]
        for found in dict.fromkeys(filter(None, map(shutil.which, names))):
            if _answer(Path(found), _VERSION) == f"{version[0]} {version[1]}":
                yield Path(found)
                break


def python_version(python: Path) -> pins.Version | None:
    """A Python's version, None where it does not start."""
    major, _, minor = (_answer(python, _VERSION) or "").partition(" ")
    return (int(major), int(minor)) if major.isdigit() and minor.isdigit() else None


def install(plan: Plan, tell: Teller) -> None:
    """Install the pinned packages.

    PyTorch's builds lie on a site of its own; where that can't be reached the package index's build is
    taken, which runs as well but may be larger.

    Raises:
        FiptError: those of `pip_error`.
    """
    packages = site_packages(plan.folder)
    source = ["--no-index", "--find-links", str(plan.wheels)] if plan.wheels else []
    if pins.read_stamp(plan.folder).get("torch", plan.torch) != plan.torch:
        run_pip(plan.python, ["uninstall", "--yes", "torch"], PipProgress(packages, 0.01, tell))
    if plan.pip:
        tell.detail("Updating pip")  # where that fails, an older one may do
        run_pip(plan.python, ["install", *source, *plan.pip], PipProgress(packages, 0.01, tell))
    bar = progress_bar(_answer(plan.python, _PIP_VERSION) or "")
    tell.detail("Looking up the packages")
    requirement, index = torch_requirement(plan.requirements, plan.torch), torch_index(plan.torch)
    if requirement and index and not plan.wheels:
        patience = ["--retries", "1", "--timeout", "20", "--extra-index-url", index]
        progress = PipProgress(packages, SIZES[plan.torch].download_gb, tell)
        if run_pip(plan.python, ["install", *patience, requirement], progress, bar):
            tell.warning(
                "torch-index",
                f"PyTorch's own download site has no usable build here ({(progress.errors or ['?'])[-1]}).",
                "The package index's build is installed instead; it runs as well, but may be larger.",
            )
            check_space(plan, "", tell)
    progress = PipProgress(packages, 0.0 if plan.wheels else SIZES[plan.torch].download_gb, tell)
    if run_pip(plan.python, ["install", *source, *plan.requirements], progress, bar):
        raise pip_error(progress, plan.wheels)


def provide_system_libraries(plan: Plan, tell: Teller) -> None:
    """Fetch what the packages link to and a bare Linux lacks (bpy: a desktop's; Dr.Jit: libatomic).

    Raises:
        FiptError: ``package-broken``.
    """
    if not (failure := import_failure(plan)):
        return
    names: list[str] = []
    if sys.platform == "linux" and "cannot open shared object file" in failure and plan.wheels is None:
        tell.detail("Fetching system libraries that this machine lacks")
        with provision.DebianPackages() as debian:
            names = debian.missing(provision.DEBIAN_LIBRARIES) if debian.available else []
            root = debian.unpack(names) if names else None
            if root is not None:
                provision.copy_libraries(root, system_folder(plan.python))
        failure = import_failure(plan)
    if failure:
        how = f"As root: apt-get install {' '.join(names)}" if names else "Install the library that is named."
        raise FiptError("package-broken", f"An installed package can't be imported: {failure}", how)


def import_failure(plan: Plan) -> str:
    """Import each package with native code in a process of its own; the first failure, or nothing."""
    for module in plan.modules:
        result = _quiet([str(plan.python), "-I", "-c", f"import {module}"], plan.python)
        if result.returncode != 0:
            return _said(result)
    return ""


def provide_llvm(plan: Plan, tell: Teller) -> str | None:
    """Find an LLVM that works or fetch one: the pinned package, else Debian's.

    Returns:
        Its path; None where a GPU is used instead.

    Raises:
        FiptError: ``llvm-missing``, or what the engine's check says.
    """
    folder = plan.folder / "llvm"
    reason: FiptError | None = None
    fetchers: list[Callable[[Plan, Path], bool] | None] = [None, _fetch_llvm_package]
    if plan.wheels is None:
        fetchers.append(_fetch_llvm_debian)
    for fetch in fetchers:
        if fetch is not None:
            tell.detail("No working LLVM on this machine; fetching one")
            shutil.rmtree(folder, ignore_errors=True)
            if not fetch(plan, folder):
                continue
        found, problem = check_engine(plan.python)
        if found.get("device"):
            return found["llvm"]
        reason = reason or problem
    assert reason is not None
    raise reason


def check_engine(python: Path) -> tuple[dict[str, Any], FiptError]:
    """What the engine's `check` finds, and its first warning or error."""
    result = _quiet(engine_command(python, "check"), python)
    messages = [message for line in result.stdout.splitlines() if (message := parse_message(line))]
    problems = [message for message in messages if message["type"] in ("warning", "error")]
    problems.sort(key=lambda message: message["code"] != "llvm-missing")
    data: dict[str, Any] = next((message["data"] for message in messages if message["type"] == "done"), {})
    if problems:
        return data, FiptError(problems[0]["code"], problems[0]["text"], problems[0]["remedy"])
    text = f"The engine's check failed: {_said(result)}"
    return data, FiptError("engine-failed", text, "Set up the engine again.")


def _fetch_llvm_package(plan: Plan, folder: Path) -> bool:
    """Take LLVM's libraries out of the pinned wheel; True where the platform has one."""
    with tempfile.TemporaryDirectory() as temporary:
        source = ["--no-index", "--find-links", str(plan.wheels)] if plan.wheels else []
        options = ["--no-deps", "--no-input", "--only-binary", ":all:", "--disable-pip-version-check"]
        pip = [str(plan.python), "-I", "-m", "pip", "download", "--quiet", "--dest", temporary]
        _quiet([*pip, *options, *source, *plan.llvm], plan.python)
        wheels = list(Path(temporary).glob("*.whl"))
        return any(provision.wheel_libraries(wheel, folder, LLVM_LIBRARIES) for wheel in wheels)


def _fetch_llvm_debian(plan: Plan, folder: Path) -> bool:
    """Take LLVM and the libraries that it needs out of Debian's packages; True where it has some."""
    with provision.DebianPackages() as debian:
        for name in provision.DEBIAN_LLVM if debian.available else ():
            if needed := debian.needed(name):
                root = debian.unpack(needed)
                return root is not None and bool(provision.copy_libraries(root, folder))
    return False


def plan_key(*facts: Any) -> str:
    """A key of what an environment depends on besides its folder: anything that JSON can write."""
    return json.dumps([*facts, platform.machine(), sys.platform], sort_keys=True)


def _said(result: subprocess.CompletedProcess[str]) -> str:
    """The end of what a failed child printed."""
    text = (result.stderr.strip() or result.stdout.strip())[-600:]
    return text or f"{' '.join(result.args)} ends with status {result.returncode}"


def _answer(python: Path, code: str) -> str | None:
    """What a Python prints for a line of code; None where it can't be run."""
    if not python.is_file():
        return None
    result = _quiet([str(python), "-I", "-c", code])
    return result.stdout.strip() if result.returncode == 0 else None


def _quiet(command: list[str], python: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a step of set-up and keep its output for a message."""
    try:
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            env=engine_environment(python),
            check=False,
        )
    except OSError as error:
        return subprocess.CompletedProcess(command, 127, "", str(error))
