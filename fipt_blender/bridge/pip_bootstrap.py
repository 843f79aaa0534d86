# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting pip into a virtual environment whose Python has no ensurepip. Standard library only."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from . import pins, provision
from .child import answer, run_quietly
from .hashes import check_file, file_digest, pinned_digests
from .plan import Plan

VERSION = "import sys; print(*sys.version_info[:2])"
PIP_INSIDE = "import pip, sys; print(*sys.version_info[:2])"
_BUNDLED = "import ensurepip, pathlib; print(*pathlib.Path(ensurepip.__file__).parent.rglob('pip-*.whl'))"
DEBIAN_WHEELS = Path("/usr/share/python-wheels")


def bootstrap_pip(plan: Plan) -> bool:
    """Install pip into the plan's environment from a wheel that is found; returns whether that worked.

    Raises:
        FiptError: ``package-hash`` where the folder of wheels has the pinned pip, but not its file.
    """
    for install in (_pip_from_wheels, _pip_from_system, _pip_from_pythons, _pip_from_debian):
        if install(plan) and answer(plan.python, PIP_INSIDE) is not None:
            return True
    return False


def _install_wheel(plan: Plan, wheel: Path) -> bool:
    """Let a wheel of pip install itself; it must be trusted, since its code runs."""
    command = [str(plan.python), f"{wheel}/pip", "install", "--no-index", "--no-deps", str(wheel)]
    return run_quietly(command).returncode == 0


def _pip_from_wheels(plan: Plan) -> bool:
    """From the folder of wheels, which may be anybody's: only a file with the pinned hash is run.

    What is run is a copy that was checked, so that nobody can exchange the file in between.
    """
    if plan.wheels is None:
        return False
    digests = pinned_digests(plan.pip)
    pinned = {pins.without_hashes(pin).replace("==", "-") for pin in plan.pip}
    for wheel in sorted(plan.wheels.glob("pip-*.whl")):
        with tempfile.TemporaryDirectory() as temporary:
            copy = Path(shutil.copyfile(wheel, Path(temporary) / wheel.name))
            if "-".join(wheel.name.split("-")[:2]) in pinned:
                check_file(copy, digests)
            if file_digest(copy) in digests and _install_wheel(plan, copy):
                return True
    return False


def _pip_from_system(plan: Plan) -> bool:
    """From Debian's wheels, which belong to the system as Python itself does."""
    return any(_install_wheel(plan, wheel) for wheel in sorted(DEBIAN_WHEELS.glob("pip-*.whl")))


def _pip_from_pythons(plan: Plan) -> bool:
    """From the wheel of pip that other Pythons of this machine contain, the newest Python first."""
    for python in other_pythons():
        for wheel in (answer(python, _BUNDLED) or "").split():
            if _install_wheel(plan, Path(wheel)):
                return True
    return False


def _pip_from_debian(plan: Plan) -> bool:
    if plan.wheels is not None:  # without network
        return False
    with provision.DebianPackages() as debian:
        root = debian.unpack(["python3-pip-whl"]) if debian.available else None
        wheel = next(root.rglob("pip-*.whl"), None) if root else None
        return wheel is not None and _install_wheel(plan, wheel)


def other_pythons() -> Iterator[Path]:
    """Pythons on the search path in which the engine can run, the newest first."""
    for version in sorted(pins.ENGINE_PYTHONS, reverse=True):
        names = [f"python{version[0]}.{version[1]}", "python3", "python"]
        for path in dict.fromkeys(filter(None, map(shutil.which, names))):
            if answer(Path(path), VERSION) == f"{version[0]} {version[1]}":
                yield Path(path)
                break


def python_version(python: Path) -> pins.Version | None:
    """The version of a Python; None if it does not start."""
    major, _, minor = (answer(python, VERSION) or "").partition(" ")
    return (int(major), int(minor)) if major.isdigit() and minor.isdigit() else None
