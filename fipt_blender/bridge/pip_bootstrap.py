# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting pip into a virtual environment whose Python has no ensurepip. Standard library only."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..core.run.errors import FiptError
from . import pins, provision
from .child import answer, run_quietly
from .plan import Plan

VERSION = "import sys; print(*sys.version_info[:2])"
PIP_INSIDE = "import pip, sys; print(*sys.version_info[:2])"


def bootstrap_pip(plan: Plan) -> bool:
    """Install pip into the plan's environment, from the folder of wheels or else from Debian's package.

    Returns whether that worked.

    Raises:
        FiptError: ``package-hash`` where the folder of wheels has the pinned pip, but not its file.
    """
    installed = _pip_from_debian(plan) if plan.wheels is None else _pip_from_wheels(plan, plan.wheels)
    return installed and answer(plan.python, PIP_INSIDE) is not None


def _install_wheel(plan: Plan, wheel: Path) -> bool:
    """Let a wheel of pip install itself; it must be trusted, since its code runs."""
    command = [str(plan.python), f"{wheel}/pip", "install", "--no-index", "--no-deps", str(wheel)]
    return run_quietly(command).returncode == 0


def _pip_from_wheels(plan: Plan, wheels: Path) -> bool:
    """From the folder of wheels, which may be anybody's: only a file with the pinned hash is run.

    What is run is a copy that was checked, so that nobody can exchange the file in between.
    """
    for pin in plan.pip:
        for wheel in sorted(wheels.glob(f"{pins.without_hashes(pin).replace('==', '-')}-*.whl")):
            with tempfile.TemporaryDirectory() as temporary:
                copy = Path(shutil.copyfile(wheel, Path(temporary) / wheel.name))
                if f"--hash=sha256:{hashlib.sha256(copy.read_bytes()).hexdigest()}" not in pin.split():
                    raise FiptError(
                        "package-hash",
                        f"{wheel.name} is not the file that this version was made with.",
                        "Do not use that folder of wheels, or ask its owner why the file was changed.",
                    )
                return _install_wheel(plan, copy)
    return False


def _pip_from_debian(plan: Plan) -> bool:
    """From the system's packages, whose signatures apt checks; Pythons of other systems have ensurepip."""
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
