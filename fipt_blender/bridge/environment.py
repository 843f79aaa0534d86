"""Making the engine's environment: a virtual environment, the pinned packages, system libraries, an LLVM.

`dev.py` and the add-on (:mod:`.setup`) use the same code. Standard library only.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urljoin

from ..core.run.errors import FiptError
from ..core.run.runfolder import explained_write_errors, write_json
from . import pins
from .interpreter import answer, output_end, run_quietly
from .native import provide_llvm, provide_system_libraries
from .pip import Pip, Teller, pip_settings
from .plan import Plan
from .torch_build import LOCKED_GB, SIZES, torch_index, torch_requirement

# Shares of the time of all installations that PyTorch alone, and PyTorch and the locked packages take.
_TORCH_SHARE, _LOCKED_SHARE = 0.35, 0.9
VERSION = "import sys; print(*sys.version_info[:2])"
_PIP_INSIDE = "import pip, sys; print(*sys.version_info[:2])"
# Where the Python Package Index has the wheels of pip, which are of pure Python, by their names.
PIP_WHEELS = "https://files.pythonhosted.org/packages/py3/p/pip"


def set_up(plan: Plan, tell: Teller) -> None:
    """Make or complete an environment; of a complete one only the packages are checked.

    Raises:
        FiptError: what is wrong and what to do.
    """
    check_space(plan, plan.torch, tell)
    tell.stage("environment", "Making the Python environment")
    make_environment(plan)
    tell.stage("packages", "Looking up the packages")
    install(plan, tell)
    _stamp(plan, complete=False, llvm=None)
    tell.stage("libraries", "Checking system libraries")
    provide_system_libraries(plan, tell)
    tell.stage("llvm", "Testing the devices")
    _stamp(plan, complete=True, llvm=provide_llvm(plan, tell))


def _stamp(plan: Plan, complete: bool, llvm: str | None) -> None:
    stamp = pins.Stamp(plan.key, True, complete, llvm, plan.torch)
    write_json(plan.folder / pins.STAMP_NAME, stamp)


def check_space(plan: Plan, build: str, tell: Teller) -> None:
    """Check whether the disk has enough space for an environment with a build of PyTorch.

    Which build the package index has is not known in advance: if the space might be too small for it, this
    is a warning.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    if pins.read_stamp(plan.folder).installed:
        return
    with explained_write_errors(plan.folder):
        plan.folder.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(plan.folder.parent).free / 1e9
    expected = pins.unpacked_gb(plan.wheels) if plan.wheels else SIZES[build].disk_gb
    least = expected if plan.wheels or build else SIZES["cpu"].disk_gb
    place = f"in {plan.folder.parent}, but only {free:.1f} GB are free."
    remedy = "Free some space, or choose a data folder on another disk."
    if free < least:
        raise FiptError("disk-full.check-space", least=least, place=place, remedy=remedy)
    if free < expected:
        tell.warning("disk-full.check-space-2", expected=expected, place=place, remedy=remedy)


def make_environment(plan: Plan) -> None:
    """Make the virtual environment with the pinned pip; where that can't be had, with Python's own.

    One of an earlier set-up that did not finish is made anew, since its state is unknown; its downloads are
    in pip's cache.

    Raises:
        FiptError: ``python-unfit``; ``package-hash`` (`_install_pip`).
    """
    folder, python = plan.folder, plan.python
    wanted = answer(plan.base, VERSION)
    if wanted is None:
        raise FiptError("python-unfit.make-environment-2", base=plan.base)
    if answer(python, _PIP_INSIDE) == wanted and pins.read_stamp(folder).installed:
        return
    shutil.rmtree(folder, ignore_errors=True)
    result = run_quietly([str(plan.base), "-I", "-m", "venv", "--without-pip", str(folder)])
    if result.returncode == 0 and not _install_pip(plan):
        result = run_quietly([str(python), "-I", "-m", "ensurepip"])
    if result.returncode == 0:
        return
    shutil.rmtree(folder, ignore_errors=True)
    raise FiptError("python-unfit.make-environment", base=plan.base, output_end=output_end(result))


def _install_pip(plan: Plan) -> bool:
    """Let the wheel of the pinned pip install itself, of the folder of wheels or downloaded.

    What runs is a copy whose hash is the pinned one, so that nobody can exchange the file in between.

    Returns:
        Whether that worked.

    Raises:
        FiptError: ``package-hash`` where there is such a wheel, but not the file that is pinned.
    """
    if not plan.pip:
        return False
    (pin,) = plan.pip
    name = f"{pins.without_hashes(pin).replace('==', '-')}-py3-none-any.whl"
    sources = pip_sources(name) if plan.wheels is None else [(plan.wheels / name).as_uri()]
    content = next(filter(None, map(_fetched, sources)), None)
    if content is None:
        return False
    if f"--hash=sha256:{hashlib.sha256(content).hexdigest()}" not in pin.split():
        raise FiptError("package-hash.install-pip", name=name)
    with tempfile.TemporaryDirectory() as temporary:
        wheel = Path(temporary, name)
        wheel.write_bytes(content)
        command = [str(plan.python), f"{wheel}/pip", "install", "--no-index", "--no-deps", str(wheel)]
        return run_quietly(command).returncode == 0


def _fetched(address: str) -> bytes | None:
    """What an address holds; None where it can't be had."""
    try:
        with urllib.request.urlopen(address, timeout=30.0) as answered:
            return bytes(answered.read())
    except (OSError, ValueError):
        return None


def pip_sources(name: str) -> Iterator[str]:
    """Addresses of a wheel of pip: by the user's configuration (find-links, indexes), then the usual one."""
    settings = pip_settings()
    for place in settings.get("find-links", "").split():
        folder = place if "://" in place else Path(place).expanduser().absolute().as_uri()
        yield f"{folder.rstrip('/')}/{name}"
    for index in f"{settings.get('index-url', '')} {settings.get('extra-index-url', '')}".split():
        page = f"{index.rstrip('/')}/pip/"
        text = (_fetched(page) or b"").decode("utf-8", "replace")
        yield from (urljoin(page, each) for each in re.findall(rf'href="([^"#]*{re.escape(name)})[#"]', text))
    yield f"{PIP_WHEELS}/{name}"


def install(plan: Plan, tell: Teller) -> None:
    """Install the pinned packages, wheels only.

    PyTorch comes first, alone, since its build depends on the machine; its builds come from its own site.
    Then come the locked packages, each checked against its hashes, then whatever is still missing: CUDA's
    libraries, which PyTorch pins, and the packages of a checkout.

    Raises:
        FiptError: those of `pip_error`.
    """
    pip, build = Pip(plan.python, plan.wheels, tell), plan.torch
    if plan.wheels is None:
        tell.detail(f"Looking up the packages (about {SIZES[build].download_gb:.1f} GB)")
    if plan.lock:
        build = _install_torch(plan, pip, tell)
        span = _TORCH_SHARE, _LOCKED_SHARE
        pip.run_locked(plan.lock, "install", expected_gb=LOCKED_GB, span=span)
    span = _LOCKED_SHARE if plan.lock else 0.0, 1.0
    pip.run("install", *plan.requirements, expected_gb=SIZES[build].download_gb, span=span)


def _install_torch(plan: Plan, pip: Pip, tell: Teller) -> str:
    """Install PyTorch without what it needs; returns its build, a key of `SIZES`.

    Raises:
        FiptError: ``disk-full`` and those of `pip_error`.
    """
    build, span = plan.torch, (0.0, _TORCH_SHARE)
    install = ["install", "--no-deps"]
    if (pins.read_stamp(plan.folder).torch or build) != build:
        install.append("--force-reinstall")  # another build of the same version would do for pip
    requirement, index = torch_requirement(plan.requirements, build), torch_index(build)
    if requirement and index and not plan.wheels:
        patience = ["--retries", "1", "--timeout", "20", "--extra-index-url", index]
        try:
            pip.run(*install, *patience, requirement, expected_gb=SIZES[build].torch_gb, span=span)
            return build
        except FiptError as error:
            tell.warning("torch-index", text=error.text)
        build = ""
        check_space(plan, build, tell)
    for pin in plan.requirements:
        if pin.startswith("torch=="):
            pip.run(*install, pin, expected_gb=SIZES[build].torch_gb, span=span)
    return build
