# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting pip into a virtual environment whose Python has no ensurepip. Standard library only."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from ..core.run.errors import FiptError
from . import pins
from .child import answer, run_quietly
from .plan import Plan

VERSION = "import sys; print(*sys.version_info[:2])"
PIP_INSIDE = "import pip, sys; print(*sys.version_info[:2])"


# Where the Python Package Index has the wheels of pip, which are of pure Python, by their names.
PIP_WHEELS = "https://files.pythonhosted.org/packages/py3/p/pip"


def bootstrap_pip(plan: Plan) -> bool:
    """Let the wheel of the pinned pip install itself, of the folder of wheels or downloaded.

    What runs is a copy whose hash is the pinned one, so that nobody can exchange the file in between.

    Returns:
        Whether that worked.

    Raises:
        FiptError: ``package-hash`` where there is such a wheel, but not the file that is pinned.
    """
    for pin in plan.pip:
        name = f"{pins.without_hashes(pin).replace('==', '-')}-py3-none-any.whl"
        source = f"{PIP_WHEELS}/{name}" if plan.wheels is None else (plan.wheels / name).as_uri()
        try:
            with urllib.request.urlopen(source, timeout=30.0) as answered:
                content = answered.read()
        except OSError:
            return False
        if f"--hash=sha256:{hashlib.sha256(content).hexdigest()}" not in pin.split():
            raise FiptError(
                "package-hash",
                f"{name} is not the file that this version was made with.",
                "Do not use the folder of wheels or the network that it came from, or ask their owner why it"
                " was changed.",
            )
        with tempfile.TemporaryDirectory() as temporary:
            wheel = Path(temporary, name)
            wheel.write_bytes(content)
            command = [str(plan.python), f"{wheel}/pip", "install", "--no-index", "--no-deps", str(wheel)]
            return run_quietly(command).returncode == 0 and answer(plan.python, PIP_INSIDE) is not None
    return False


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
