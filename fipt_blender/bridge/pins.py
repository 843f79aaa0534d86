# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which packages the engine needs, and which environment holds them. Standard library only.

pyproject.toml is the only place of the pins; `dev.py build` copies them into the extension's zip.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import sys
import zipfile
from pathlib import Path
from typing import Any

from ..core.job.errors import FiptError
from ..core.job.runfolder import read_json
from .places import PACKAGE_FOLDER, environment_python

PINS_NAME = "engine_pins.json"
ENGINE_GROUPS = ("engine", "llvm", "pip")  # what the add-on needs of them
STAMP_NAME = "setup.json"
ENGINE_PYTHONS = ((3, 11), (3, 12), (3, 13), (3, 14))  # those that every pinned package has wheels for

Version = tuple[int, int]


def read_pins(package: Path = PACKAGE_FOLDER) -> dict[str, list[str]]:
    """Requirements by group: ``engine``, ``llvm`` and ``pip``.

    In a checkout there are ``blender``, ``dev`` and ``cluster`` too.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    copied = package / PINS_NAME
    if copied.exists():
        return read_json(copied)
    import tomllib

    file = package.parent / "pyproject.toml"
    try:
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
    except (OSError, ValueError, KeyError) as error:
        raise FiptError(
            "file-missing", f"The list of the engine's packages, {copied}, can't be read ({error}).",
            "Install the extension again.",
        ) from None  # fmt: skip
    return {"engine": project["dependencies"], **project["optional-dependencies"]}


def environment_name(pins: dict[str, list[str]], version: Version) -> str:
    """Name of the environment that belongs to these packages and a Python's version."""
    text = json.dumps([pins["engine"], sys.platform, platform.machine()])
    return f"engine-{version[0]}.{version[1]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def environments(data: Path) -> list[Path]:
    """Every environment in a data folder, finished or not, of any version of the add-on."""
    return sorted(path for path in data.glob("engine-*") if path.is_dir() and _version(path))


def managed_environments(data: Path) -> list[Path]:
    """The finished environments in a data folder that have the packages pinned now, best first.

    The one of the running interpreter's version leads: the one that it made itself.
    """
    pins = read_pins()
    found = []
    for folder in environments(data):
        version = _version(folder)
        if version and folder.name == environment_name(pins, version) and read_stamp(folder).get("complete"):
            found.append((version != sys.version_info[:2], folder))
    return [folder for _, folder in sorted(found)]


def read_stamp(folder: Path) -> dict[str, Any]:
    """What set-up noted in an environment; empty where it was not finished once.

    ``key`` (what was asked for), ``installed`` (the packages are there), ``complete``, ``llvm`` (the LLVM
    that it needs, or null), ``torch`` (which build).
    """
    try:
        return read_json(folder / STAMP_NAME)
    except FiptError:
        return {}


def is_set_up(folder: Path, key: str) -> bool:
    """Whether an earlier set-up with this key still stands."""
    stamp = read_stamp(folder)
    if stamp.get("key") != key or not stamp.get("complete") or not environment_python(folder).exists():
        return False
    return stamp.get("llvm") is None or Path(stamp["llvm"]).exists()


def wheel_command(pins: dict[str, list[str]], version: Version, folder: str = "wheels") -> str:
    """The command that fills a folder with all that an offline machine of the same kind needs."""
    names = [*pins["pip"], *pins["engine"], *pins["llvm"]]
    quoted = " ".join(f'"{name}"' if ";" in name else name for name in names)
    return f"python{version[0]}.{version[1]} -m pip download --only-binary :all: --dest {folder} {quoted}"


def wheel_pythons(folder: Path, pins: dict[str, list[str]]) -> list[Version]:
    """The versions of Python for which a folder has the wheel of the engine's main package."""
    pinned = next((pin for pin in pins["engine"] if pin.startswith("mitsuba==")), "")
    version = pinned.partition("==")[2].partition(";")[0].strip()
    found = []
    for wheel in folder.glob(f"mitsuba-{version}-cp3*.whl"):
        if match := re.search(r"-cp3(\d+)-", wheel.name):
            found.append((3, int(match.group(1))))
    return sorted(set(found) & set(ENGINE_PYTHONS))


def unpacked_gb(folder: Path) -> float:
    """About what the packages of a folder of wheels take on the disk (GB): the largest wheel of each.

    A file that is no wheel counts as it is; pip will say what is wrong with it.
    """
    largest: dict[str, int] = {}
    for wheel in folder.glob("*.whl"):
        try:
            with zipfile.ZipFile(wheel) as archive:
                size = sum(member.file_size for member in archive.infolist())
        except (OSError, zipfile.BadZipFile):
            size = wheel.stat().st_size
        name = wheel.name.partition("-")[0]
        largest[name] = max(size, largest.get(name, 0))
    return sum(largest.values()) / 1e9


def other_versions(groups: dict[str, list[str]], found: dict[str, str | None]) -> list[str]:
    """Packages whose version is none that is pinned, as "name version (pinned version)".

    Args:
        groups: see `read_pins`.
        found: version by package, None where it is missing; builds ("+cpu") count alike.
    """
    pinned: dict[str, list[str]] = {}
    for pin in groups["engine"]:
        name, _, version = pin.partition(";")[0].strip().partition("==")
        pinned.setdefault(name.lower(), []).append(version)
    others = []
    for name, installed in found.items():
        wanted = pinned.get(name.lower())
        if installed and wanted and installed.partition("+")[0] not in wanted:
            others.append(f"{name} {installed} ({' or '.join(wanted)})")
    return others


def _version(folder: Path) -> Version | None:
    match = re.fullmatch(r"engine-(\d+)\.(\d+)-[0-9a-f]{8}", folder.name)
    return (int(match.group(1)), int(match.group(2))) if match else None
