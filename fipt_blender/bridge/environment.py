# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Making the engine's environment: a virtual environment, the pinned packages, system libraries, an LLVM.

`dev.py` and the add-on (:mod:`.setup`) use the same code. Standard library only.
"""

from __future__ import annotations

import shutil

from ..core.run.errors import FiptError
from ..core.run.runfolder import explained_write_errors, write_json
from . import pins
from .child import answer, output_end, run_quietly
from .native import provide_llvm, provide_system_libraries
from .pip import PipProgress, Teller, pip_error, progress_bar, run_locked, run_pip, source
from .pip_bootstrap import PIP_INSIDE, VERSION, bootstrap_pip
from .plan import Plan
from .torch_build import LOCKED_GB, SIZES, torch_index, torch_requirement

# Shares of the time of all installations that PyTorch alone, and PyTorch and the locked packages take.
_TORCH_SHARE, _LOCKED_SHARE = 0.35, 0.9
_PIP_VERSION = "import pip; print(pip.__version__)"


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
        raise FiptError("disk-full", f"The packages need {least:.1f} GB {place}", remedy)
    if free < expected:
        tell.warning("disk-full", f"The packages may need {expected:.1f} GB {place}", remedy)


def make_environment(plan: Plan) -> None:
    """Make the virtual environment, even if Python lacks ensurepip (Debian without python3-venv).

    One of an earlier set-up that did not finish is made anew, since its state is unknown; its downloads are
    in pip's cache.

    Raises:
        FiptError: ``python-unfit``; ``package-hash`` (`bootstrap_pip`).
    """
    folder, python = plan.folder, plan.python
    wanted = answer(plan.base, VERSION)
    if wanted is None:
        raise FiptError("python-unfit", f"{plan.base} does not start.", "Choose another Python.")
    if folder.exists():
        fits = answer(python, PIP_INSIDE) == wanted
        if fits and pins.read_stamp(folder).installed:
            return
        shutil.rmtree(folder, ignore_errors=True)
    if run_quietly([str(plan.base), "-I", "-m", "venv", str(folder)]).returncode == 0:
        return
    shutil.rmtree(folder, ignore_errors=True)
    result = run_quietly([str(plan.base), "-I", "-m", "venv", "--without-pip", str(folder)])
    if result.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        raise FiptError(
            "python-unfit",
            f"{plan.base} can't make a virtual environment: {output_end(result)}",
            "Install Python's module venv (Debian, Ubuntu: apt-get install python3-venv) or another Python.",
        )
    if bootstrap_pip(plan):
        return
    shutil.rmtree(folder, ignore_errors=True)
    raise FiptError(
        "python-unfit",
        f"The Python {plan.base} can't install packages: it has neither pip nor ensurepip.",
        "Install them (Debian, Ubuntu: apt-get install python3-venv) or another Python, and set up again.",
    )


def install(plan: Plan, tell: Teller) -> None:
    """Install the pinned packages, wheels only.

    pip itself comes first, in the pinned version. PyTorch follows, alone, since its build depends on the
    machine; its builds come from its own site. Then come the locked packages, each checked against its
    hashes, then whatever is still missing: CUDA's libraries, which PyTorch pins, and the packages of a
    checkout.

    Raises:
        FiptError: ``package-hash`` and those of `pip_error`.
    """
    if (pins.read_stamp(plan.folder).torch or plan.torch) != plan.torch:
        run_pip(plan.python, ["uninstall", "--yes", "torch"], PipProgress(0.01, tell))
    _update_pip(plan, tell)
    bar = progress_bar(answer(plan.python, _PIP_VERSION) or "")
    size = 0.0 if plan.wheels else SIZES[plan.torch].download_gb
    tell.detail(f"Looking up the packages (about {size:.1f} GB)" if size else "Looking up the packages")
    build = plan.torch
    if plan.lock:
        build = _install_torch(plan, tell, bar)
        size = 0.0 if plan.wheels else SIZES[build].download_gb
        _install_locked(plan, tell, bar, (_TORCH_SHARE, _LOCKED_SHARE))
    progress = PipProgress(size, tell, (_LOCKED_SHARE if plan.lock else 0.0, 1.0))
    if run_pip(plan.python, ["install", *source(plan.wheels), *plan.requirements], progress, bar):
        raise pip_error(progress, plan.wheels)


def _update_pip(plan: Plan, tell: Teller) -> None:
    """Install the pinned pip; if it can't be had, the older version may be sufficient.

    Raises:
        FiptError: ``package-hash``.
    """
    if not plan.pip or f"pip=={answer(plan.python, _PIP_VERSION)}" in map(pins.without_hashes, plan.pip):
        return
    tell.detail("Updating pip")
    progress = PipProgress(0.01, tell)
    run_locked(plan.python, ["install", *source(plan.wheels)], plan.pip, progress)
    if progress.mismatch:
        raise pip_error(progress, plan.wheels)


def _install_torch(plan: Plan, tell: Teller, bar: str) -> str:
    """Install PyTorch without what it needs; returns its build, a key of `SIZES`.

    Raises:
        FiptError: ``disk-full`` and those of `pip_error`.
    """
    build = plan.torch
    requirement, index = torch_requirement(plan.requirements, build), torch_index(build)
    if requirement and index and not plan.wheels:
        patience = ["--retries", "1", "--timeout", "20", "--extra-index-url", index]
        progress = PipProgress(SIZES[build].torch_gb, tell, (0.0, _TORCH_SHARE))
        arguments = ["install", "--no-deps", *source(plan.wheels), *patience, requirement]
        if run_pip(plan.python, arguments, progress, bar) == 0:
            return build
        tell.warning(
            "torch-index",
            f"PyTorch's download site offers no usable build ({(progress.errors or ['?'])[-1]}).",
            "The package index's build is installed instead; it works too, but may be larger.",
        )
        build = ""
        check_space(plan, build, tell)
    pin = next((each for each in plan.requirements if each.startswith("torch==")), "")
    if pin:
        size = 0.0 if plan.wheels else SIZES[build].torch_gb
        progress = PipProgress(size, tell, (0.0, _TORCH_SHARE))
        if run_pip(plan.python, ["install", "--no-deps", *source(plan.wheels), pin], progress, bar):
            raise pip_error(progress, plan.wheels)
    return build


def _install_locked(plan: Plan, tell: Teller, bar: str, span: tuple[float, float]) -> None:
    """Install the locked packages.

    Raises:
        FiptError: those of `pip_error`.
    """
    progress = PipProgress(0.0 if plan.wheels else LOCKED_GB, tell, span)
    if run_locked(plan.python, ["install", *source(plan.wheels)], plan.lock, progress, bar):
        raise pip_error(progress, plan.wheels)
