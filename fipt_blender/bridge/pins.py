"""The pinned packages of the engine, and the environments that contain them. Standard library only.

Pins are defined in pyproject.toml alone; `dev.py build` copies them into the extension's zip.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

from ..core.run.documents import optional_document, read_document
from ..core.run.errors import FiptError
from .places import PACKAGE_FOLDER, environment_python

PINS_NAME = "engine_pins.json"
LOCK_NAME = "engine.lock"
ENGINE_GROUPS = ("engine", "llvm", "pip", "lock")  # the groups that the add-on needs
TOOL_GROUPS = ("pip", "llvm")  # whose pins get the hashes of the lock
STAMP_NAME = "setup.json"
ENGINE_PYTHONS = ((3, 11), (3, 12), (3, 13), (3, 14))  # for these all pinned packages have wheels

Version = tuple[int, int]


def read_pins(package: Path = PACKAGE_FOLDER) -> dict[str, list[str]]:
    """Requirements by group: ``engine``, ``llvm``, ``pip`` and ``lock``.

    Those of ``llvm`` and ``pip`` have the hashes of their files, as far as the lock file knows them.
    ``lock`` has every package that the engine needs, with its version and the hashes of its files, but for
    PyTorch and what only its CUDA builds need: which build is installed depends on the machine. A checkout
    also has ``blender``, ``dev``, ``cluster``, ``heif`` and ``markers``.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    copied = package / PINS_NAME
    if copied.exists():
        return read_document(copied, dict[str, list])
    import tomllib

    file = package.parent / "pyproject.toml"
    try:
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
    except (OSError, ValueError, KeyError) as error:
        raise FiptError("file-missing.read-pins", copied=copied, error=error) from None  # fmt: skip
    lock = package.parent / LOCK_NAME
    locked = parse_lock(lock.read_text(encoding="utf-8")) if lock.exists() else []
    groups = {"engine": project["dependencies"], **project["optional-dependencies"]}
    for group in TOOL_GROUPS:
        groups[group] = [_with_hashes(pin, locked) for pin in groups.get(group, [])]
    tools = {_release(pin)[0] for group in TOOL_GROUPS for pin in groups[group]}
    return {**groups, "lock": [line for line in locked if _release(line)[0] not in tools]}


def _release(requirement: str) -> tuple[str, str]:
    """Name and version of a pinned requirement."""
    name, _, version = without_hashes(requirement).partition(";")[0].partition("==")
    return name.strip(), version.strip()


def _with_hashes(pin: str, locked: list[str]) -> str:
    """A pin with the hashes of its line in the lock; unchanged if there is none."""
    line = next((line for line in locked if _release(line) == _release(pin)), "")
    return " ".join([pin, *(part for part in line.split() if part.startswith("--hash="))])


def parse_lock(text: str) -> list[str]:
    """The requirements of a lock file, one line each: name, version, marker, hashes."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [" ".join(line.split()) for line in joined.splitlines()]


def without_hashes(requirement: str) -> str:
    """A locked requirement's name, version and marker."""
    return requirement.partition(" --hash=")[0].strip()


def environment_name(pins: dict[str, list[str]], version: Version) -> str:
    """Name of the environment for these packages and this version of Python."""
    text = json.dumps([pins["engine"], pins.get("lock", []), sys.platform, platform.machine()])
    return f"engine-{version[0]}.{version[1]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def environments(data: Path) -> list[Path]:
    """All environments in a data folder, finished or not, of all versions of the add-on."""
    return sorted(path for path in data.glob("engine-*") if path.is_dir() and _version(path))


def managed_environments(data: Path) -> list[Path]:
    """The finished environments in a data folder that contain the current pins, best first.

    The first is that of the running interpreter's version, if there is one.
    """
    pins = read_pins()
    ranked = []
    for folder in environments(data):
        version = _version(folder)
        if version and folder.name == environment_name(pins, version) and read_stamp(folder).complete:
            ranked.append((version != sys.version_info[:2], folder))
    return [folder for _, folder in sorted(ranked)]


@dataclass(frozen=True)
class Stamp:
    """What set-up has written into an environment.

    Attributes:
        key: of `plan_key`.
        installed: whether the packages are installed.
        complete: whether all is done.
        llvm: path of the LLVM that it uses, or None.
        torch: the build.
    """

    key: str = ""
    installed: bool = False
    complete: bool = False
    llvm: str | None = None
    torch: str = ""


def read_stamp(folder: Path) -> Stamp:
    """The record of an environment; empty if there is none."""
    return optional_document(folder / STAMP_NAME, Stamp) or Stamp()


def is_set_up(folder: Path, key: str) -> bool:
    """Whether an environment was completed with this key and still exists."""
    stamp = read_stamp(folder)
    if stamp.key != key or not stamp.complete or not environment_python(folder).exists():
        return False
    return stamp.llvm is None or Path(stamp.llvm).exists()


def wheel_command(pins: dict[str, list[str]], version: Version) -> str:
    """The command that downloads all wheels that an offline machine of the same kind needs."""
    locked = [without_hashes(requirement) for requirement in pins.get("lock", [])]
    torch = [pin for pin in pins["engine"] if pin.startswith("torch==")]
    pip, llvm = ([without_hashes(pin) for pin in pins[group]] for group in TOOL_GROUPS)
    names = [*pip, *(locked + torch if locked else pins["engine"]), *llvm]
    quoted = " ".join(f'"{name}"' if ";" in name else name for name in names)
    return f"python{version[0]}.{version[1]} -m pip download --only-binary :all: --dest wheels {quoted}"


def wheel_pythons(folder: Path, pins: dict[str, list[str]]) -> list[Version]:
    """The versions of Python for which a folder contains the wheel of Mitsuba."""
    pinned = next((pin for pin in pins["engine"] if pin.startswith("mitsuba==")), "")
    version = pinned.partition("==")[2].partition(";")[0].strip()
    versions = set()
    for wheel in folder.glob(f"mitsuba-{version}-cp3*.whl"):
        if match := re.search(r"-cp3(\d+)-", wheel.name):
            versions.add((3, int(match.group(1))))
    return sorted(versions & set(ENGINE_PYTHONS))


def unpacked_gb(folder: Path) -> float:
    """Approximate size (GB) of the unpacked packages of a folder; of each package the largest wheel counts.

    A file that is not a valid wheel counts with its own size; pip will report what is wrong with it.
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


def other_versions(groups: dict[str, list[str]], versions: dict[str, str | None]) -> list[str]:
    """Packages with a version that is not pinned, as "name version (pinned version)".

    Args:
        groups: see `read_pins`.
        versions: installed version by package, None if it is missing; the build ("+cpu") is ignored.
    """
    pinned: dict[str, list[str]] = {}
    for pin in groups["engine"]:
        name, _, version = pin.partition(";")[0].strip().partition("==")
        pinned.setdefault(name.lower(), []).append(version)
    others = []
    for name, installed in versions.items():
        wanted = pinned.get(name.lower())
        if installed and wanted and installed.partition("+")[0] not in wanted:
            others.append(f"{name} {installed} ({' or '.join(wanted)})")
    return others


def _version(folder: Path) -> Version | None:
    match = re.fullmatch(r"engine-(\d+)\.(\d+)-[0-9a-f]{8}", folder.name)
    return (int(match.group(1)), int(match.group(2))) if match else None
