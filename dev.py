#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The project's commands, each with all set-up included: python3 dev.py COMMAND [ARGUMENT ...]

  demo      run the main job on the example capture
  test      run the tests
  run       run the product's command line, e.g. run estimate CAPTURE --output FOLDER
  accuracy  run the engine on a capture with ground truth and print its accuracy
  lint      run ruff and mypy
  build     make the extension's zip in dist/ (needs no set-up)
  setup     only set up

Standard library only. Set-up makes the virtual environment .venv with the packages pinned in
pyproject.toml and finds or fetches an LLVM; nothing outside this folder is changed, but for caches.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Any

SUPPORTED_PYTHONS = ((3, 11), (3, 13))  # those that bpy exists for
ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
STAMP = VENV / "setup.json"
PRODUCT = ROOT / "fipt_blender" / "__main__.py"
DEMO = ("estimate", "examples/room", "--output", "out/demo", "--preset", "draft")
NATIVE_MODULES = ("bpy", "mitsuba", "torch", "OpenEXR", "pycolmap", "pyoidn")
LLVM_LIBRARIES = ("libLLVM", "libc++", "libunwind")


class SetupError(Exception):
    """Set-up can't go on; the text says what to do."""


def say(text: str) -> None:
    """Tell what set-up does; stdout belongs to the command itself."""
    print(f"set-up: {text}", file=sys.stderr, flush=True)


def read_pins(file: Path = ROOT / "pyproject.toml") -> dict[str, list[str]]:
    """Requirements by group: ``engine``, ``blender``, ``dev``, ``llvm``."""
    import tomllib

    project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
    return {"engine": project["dependencies"], **project["optional-dependencies"]}


def setup_key(pins: dict[str, list[str]], folder: Path = VENV) -> str:
    """Changes whenever set-up has to be done again: other pins, another Python, a moved checkout."""
    facts = [pins, sys.version_info[:2], platform.machine(), sys.platform, str(folder)]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def is_set_up(key: str, stamp: Path = STAMP, python: Path = VENV_PYTHON) -> bool:
    """Whether an earlier set-up with this key still stands."""
    try:
        data = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    if not isinstance(data, dict) or data.get("key") != key or not python.exists():
        return False
    return data.get("llvm") is None or Path(data["llvm"]).exists()


def child_environment() -> dict[str, str]:
    """Environment of every child: the engine's, with the libraries that set-up fetched."""
    from fipt_blender.bridge.interpreter import engine_environment

    return engine_environment(VENV_PYTHON)


def set_up() -> None:
    """Make or complete the environment; does nothing where it stands.

    Raises:
        SetupError: with what to do.
    """
    pins = read_pins()
    key = setup_key(pins)
    if is_set_up(key):
        return
    started = time.monotonic()
    make_environment()
    install(pins["engine"] + pins["blender"] + pins["dev"])
    provide_system_libraries()
    library = provide_llvm(pins["llvm"])
    STAMP.write_text(json.dumps({"key": key, "llvm": library}), encoding="utf-8")
    say(f"done in {time.monotonic() - started:.0f} seconds")


def make_environment() -> None:
    """Make .venv, also where Python lacks ensurepip (Debian without python3-venv)."""
    if VENV.exists():
        question = "import pip, sys; print(sys.version_info[:2])"
        result = quiet([str(VENV_PYTHON), "-I", "-c", question]) if VENV_PYTHON.exists() else None
        if result is not None and result.stdout.strip() == str(sys.version_info[:2]):
            return
        say("the environment .venv is of another Python or unfinished; making it again")
        shutil.rmtree(VENV)
    say(f"making the environment .venv with Python {platform.python_version()}")
    if quiet([sys.executable, "-m", "venv", str(VENV)]).returncode == 0:
        return
    shutil.rmtree(VENV, ignore_errors=True)
    result = quiet([sys.executable, "-m", "venv", "--without-pip", str(VENV)])
    if result.returncode != 0:
        raise SetupError(
            f"{sys.executable} can't make a virtual environment: {result.stderr.strip()[-300:]}\n"
            "Install Python's venv module (Debian, Ubuntu: apt-get install python3-venv) and try again."
        )
    say("this Python brings no pip; fetching Debian's")
    from fipt_blender.bridge.provision import DebianPackages

    with DebianPackages() as debian:
        root = debian.unpack(["python3-pip-whl"]) if debian.available else None
        wheel = next(root.rglob("pip-*.whl"), None) if root else None
        if (
            wheel is None
            or quiet([str(VENV_PYTHON), f"{wheel}/pip", "install", "--no-index", str(wheel)]).returncode
        ):
            shutil.rmtree(VENV)
            raise SetupError(
                "This Python can't install packages: it has neither pip nor ensurepip.\n"
                "Install them (Debian, Ubuntu: apt-get install python3-venv) and try again."
            )


def install(requirements: list[str]) -> None:
    """Install the pinned packages. pip's own configuration decides from where."""
    say("installing the pinned packages; the first time, about 1 GB comes over the network")
    command = [str(VENV_PYTHON), "-I", "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    if not sys.stderr.isatty():
        command.append("--quiet")
    status = subprocess.call([*command, *requirements], stdout=sys.stderr, cwd=ROOT, env=child_environment())
    if status != 0:
        raise SetupError(
            "The packages could not be installed; pip's message above says why.\n"
            "Without network: give pip a folder of wheels (PIP_FIND_LINKS, PIP_NO_INDEX=1).\n"
            "Behind a proxy or with an index of your own: set HTTPS_PROXY or pip's configuration.\n"
            "Then run the command again."
        )


def provide_system_libraries() -> None:
    """Fetch what the packages link to and a bare Linux lacks (bpy: a desktop's; Dr.Jit: libatomic)."""
    failure = import_failure()
    if not failure:
        return
    if sys.platform != "linux" or "cannot open shared object file" not in failure:
        raise SetupError(f"An installed package can't be imported:\n{failure}")
    from fipt_blender.bridge import interpreter, provision

    say("fetching system libraries that the packages need and this machine lacks")
    with provision.DebianPackages() as debian:
        names = debian.missing(provision.DEBIAN_LIBRARIES) if debian.available else []
        root = debian.unpack(names) if names else None
        if root is not None:
            provision.copy_libraries(root, interpreter.system_folder(VENV_PYTHON))
    if failure := import_failure():
        how = f"As root: apt-get install {' '.join(names)}" if names else "Install the library that is named."
        raise SetupError(f"An installed package can't be imported:\n{failure}\n{how}")


def import_failure() -> str:
    """Import each package with native code in a process of its own; the first failure, or nothing."""
    for module in NATIVE_MODULES:
        result = quiet([str(VENV_PYTHON), "-I", "-c", f"import {module}"])
        if result.returncode != 0:
            return result.stderr.strip()[-900:] or f"import {module} ends with status {result.returncode}"
    return ""


def provide_llvm(pins: list[str]) -> str | None:
    """Find an LLVM that works or fetch one: the pinned package, else Debian's.

    Returns:
        Its path; None where a GPU is used instead.
    """
    folder = VENV / "llvm"
    reason = ""
    for fetch in (None, fetch_llvm_package, fetch_llvm_debian):
        if fetch is not None:
            shutil.rmtree(folder, ignore_errors=True)
            if not fetch(folder, pins):
                continue
        found, problem = check_engine()
        if found.get("device"):
            return found["llvm"]
        reason = reason or problem
    raise SetupError(reason)


def check_engine() -> tuple[dict[str, Any], str]:
    """What the engine's `check` finds, and its first warning or error."""
    from fipt_blender.bridge.interpreter import engine_command
    from fipt_blender.core.job.messages import parse_message

    result = quiet(engine_command(VENV_PYTHON, "check"))
    messages = [message for line in result.stdout.splitlines() if (message := parse_message(line))]
    problems = [message for message in messages if message["type"] in ("warning", "error")]
    problems.sort(key=lambda message: message["code"] != "llvm-missing")
    data = next((message["data"] for message in messages if message["type"] == "done"), {})
    if problems:
        return data, f"{problems[0]['text']}\n{problems[0]['remedy']}"
    return data, f"The engine's check failed:\n{result.stderr.strip()[-600:]}"


def fetch_llvm_package(folder: Path, pins: list[str]) -> bool:
    """Take LLVM's libraries out of the pinned wheel; True where the platform has one."""
    from fipt_blender.bridge.provision import wheel_libraries

    say("no working LLVM on this machine; fetching one")
    with tempfile.TemporaryDirectory() as temporary:
        command = [str(VENV_PYTHON), "-I", "-m", "pip", "download", "--quiet", "--no-deps", "--no-input"]
        options = ["--only-binary", ":all:", "--disable-pip-version-check", "--dest", temporary]
        quiet([*command, *options, *pins])
        return any(wheel_libraries(wheel, folder, LLVM_LIBRARIES) for wheel in Path(temporary).glob("*.whl"))


def fetch_llvm_debian(folder: Path, pins: list[str]) -> bool:
    """Take LLVM and the libraries that it needs out of Debian's packages; True where it has some."""
    from fipt_blender.bridge import provision

    with provision.DebianPackages() as debian:
        for name in provision.DEBIAN_LLVM if debian.available else ():
            if needed := debian.needed(name):
                say(f"fetching Debian's {name}")
                root = debian.unpack(needed)
                return root is not None and bool(provision.copy_libraries(root, folder))
    return False


def quiet(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a step of set-up and keep its output for a message."""
    return subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=child_environment(),
        cwd=ROOT,
        check=False,
    )


def read_versions() -> dict[str, str]:
    """The product's version in each place that states it."""
    import tomllib

    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    code = (ROOT / "fipt_blender/core/job/runfolder.py").read_text(encoding="utf-8")
    product = re.search(r'^PRODUCT_VERSION = "(.+)"$', code, re.MULTILINE)
    log = re.search(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    return {
        "blender_manifest.toml": manifest["version"],
        "pyproject.toml": project["version"],
        "runfolder.PRODUCT_VERSION": product.group(1) if product else "",
        "CHANGELOG.md": log.group(1) if log else "",
    }


def build_extension(folder: Path = ROOT / "dist") -> Path:
    """Make the extension's zip: the manifest, the licence and the package's files at its top.

    The same files give the same bytes, whenever and wherever it is built.

    Raises:
        SetupError: where versions disagree.
    """
    versions = read_versions()
    if len(set(versions.values())) != 1:
        listed = "\n".join(f"  {place}: {version}" for place, version in versions.items())
        raise SetupError(f"The versions disagree:\n{listed}\nMake them equal.")
    package = ROOT / "fipt_blender"
    entries = {name: ROOT / name for name in ("blender_manifest.toml", "LICENSE")}
    for path in package.rglob("*"):
        parts = path.relative_to(package).parts
        hidden = any(part.startswith(".") or part == "__pycache__" for part in parts)
        if path.is_file() and not hidden and path.suffix != ".pyc":
            entries["/".join(parts)] = path
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"fipt_blender-{versions['blender_manifest.toml']}.zip"
    temporary = target.with_suffix(".part")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3  # else it tells the platform
            info.external_attr = 0o644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, entries[name].read_bytes())
    temporary.replace(target)
    return target


def call(*arguments: str) -> int:
    """Run the environment's Python; its exit status, as a shell would give it."""
    child = subprocess.Popen([str(VENV_PYTHON), *arguments], cwd=ROOT, env=child_environment())
    while True:
        try:
            status = child.wait()
        except KeyboardInterrupt:  # the child got it as well and ends in its own way
            continue
        return status if status >= 0 else 128 - status


def lint() -> int:
    """Run both tools, also where the first finds something."""
    return max(call("-m", "ruff", "check", "."), call("-m", "mypy"))


COMMANDS = {
    "demo": lambda extra: call(str(PRODUCT), *DEMO, *extra),
    "test": lambda extra: call("-m", "pytest", "-q", *extra),
    "run": lambda extra: call(str(PRODUCT), *extra),
    "accuracy": lambda extra: call(str(ROOT / "benchmarks" / "accuracy.py"), *extra),
    "lint": lambda extra: lint(),
    "setup": lambda extra: 0,
}


def other_python() -> str | None:
    """A supported Python among those on the search path."""
    for major, minor in SUPPORTED_PYTHONS:
        found = shutil.which(f"python{major}.{minor}")
        code = f"import sys; sys.exit(sys.version_info[:2] != ({major}, {minor}))"
        if found and subprocess.call([found, "-c", code], stderr=subprocess.DEVNULL) == 0:
            return found
    return None


def main(argv: list[str]) -> int:
    """Run one command; its exit status."""
    if not argv or argv[0] not in (*COMMANDS, "build"):
        print(__doc__.strip())
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    if sys.version_info[:2] not in SUPPORTED_PYTHONS:
        if python := other_python():
            return subprocess.call([python, __file__, *argv])
        wanted = " or ".join(f"{major}.{minor}" for major, minor in SUPPORTED_PYTHONS)
        print(f"This is Python {platform.python_version()}; Python {wanted} is needed.", file=sys.stderr)
        return 1
    try:
        if argv[0] == "build":
            print(build_extension())
            return 0
        set_up()
    except SetupError as error:
        print(f"dev.py: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return COMMANDS[argv[0]](argv[1:])


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
