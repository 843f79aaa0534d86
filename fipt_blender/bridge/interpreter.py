# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Python runs the engine, with which command line and environment. Standard library only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from ..core.job.errors import FiptError

PYTHON_VARIABLE = "FIPT_ENGINE_PYTHON"
PACKAGE_FOLDER = Path(__file__).resolve().parent.parent

# The package is imported from its folder by path: as an extension it is no top-level module, and its
# parent folder holds other people's extensions, which must not become importable in the engine.
_START_ENGINE = """
import importlib.util, runpy, sys
folder = sys.argv.pop(1)
spec = importlib.util.spec_from_file_location(
    "fipt_blender", folder + "/__init__.py", submodule_search_locations=[folder])
package = importlib.util.module_from_spec(spec)
sys.modules["fipt_blender"] = package
spec.loader.exec_module(package)
runpy.run_module("fipt_blender.core", run_name="__main__", alter_sys=True)
"""

_HAS_PACKAGES = """
import importlib.util, sys
missing = [name for name in ("mitsuba", "torch", "OpenEXR") if importlib.util.find_spec(name) is None]
print(sys.version.split()[0], "lacks " + ", ".join(missing) if missing else "has all")
sys.exit(1 if missing else 0)
"""


def environment_python(folder: Path) -> Path:
    """The interpreter inside a virtual environment's folder."""
    return folder / "Scripts" / "python.exe" if sys.platform == "win32" else folder / "bin" / "python"


def find_engine_python(explicit: str | None = None, managed: Path | None = None) -> Path:
    """The interpreter that runs the engine.

    An interpreter that the user names (argument, then $FIPT_ENGINE_PYTHON) is taken or refused, never
    passed over. Then come the managed environment, the checkout's ``.venv`` beside the package, and
    the running interpreter where it has the packages (Blender as a Python module).

    Args:
        explicit: an interpreter, or the folder of a virtual environment.
        managed: folder of the environment that the add-on made.

    Raises:
        FiptError: ``engine-missing``.
    """
    for named, source in ((explicit, "given"), (os.environ.get(PYTHON_VARIABLE), f"in {PYTHON_VARIABLE}")):
        if not named:
            continue
        python = Path(named).expanduser().absolute()
        if python.is_dir():
            python = environment_python(python)
        if reason := _why_not(python):
            raise FiptError(
                "engine-missing",
                f"The engine's Python {source}, {python}, can't be used: {reason}.",
                "Name an interpreter that has the engine's packages.",
            )
        return python
    candidates = [environment_python(PACKAGE_FOLDER.parent / ".venv"), Path(sys.executable or "python")]
    if managed is not None:
        candidates.insert(0, environment_python(managed))
    for python in candidates:
        if _why_not(python) is None:
            return python
    raise FiptError(
        "engine-missing",
        "No Python with the engine's packages (Mitsuba, torch and others) was found.",
        f"Run dev.py in a checkout, or set {PYTHON_VARIABLE} to an interpreter that has them.",
    )


def _why_not(python: Path) -> str | None:
    """Why an interpreter can't run the engine, or None where it can; imports nothing heavy."""
    if not python.is_file():
        return "there is no such file"
    try:
        result = subprocess.run(
            [str(python), "-I", "-c", _HAS_PACKAGES],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            env=engine_environment(python),
            timeout=60,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"it does not start ({error})"
    if result.returncode == 0:
        return None
    return (result.stdout or result.stderr).strip()[-200:] or f"it ends with status {result.returncode}"


def engine_command(python: Path, *args: str) -> list[str]:
    """The command line of one engine command, e.g. ``engine_command(python, "check")``.

    Isolated (-I): neither the working directory nor the user's site folder reaches the engine.
    """
    return [str(python), "-I", "-X", "utf8", "-c", _START_ENGINE, str(PACKAGE_FOLDER), *args]


def engine_environment(python: Path | None = None) -> dict[str, str]:
    """Environment of the engine: the caller's without what would bend its Python.

    Idle OpenMP threads sleep instead of spinning, as torch and Dr.Jit take turns on the same cores.

    Args:
        python: the engine's interpreter; system libraries kept in its environment (``system_folder``)
            become visible to the child.
    """
    environment = {key: value for key, value in os.environ.items() if not key.upper().startswith("PYTHON")}
    environment.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    environment.setdefault("KMP_BLOCKTIME", "0")
    if python is not None and sys.platform == "linux" and (folder := system_folder(python)).is_dir():
        paths = [str(folder), *environment.get("LD_LIBRARY_PATH", "").split(":")]
        environment["LD_LIBRARY_PATH"] = ":".join(dict.fromkeys(path for path in paths if path))
    return environment


def system_folder(python: Path) -> Path:
    """Where an environment keeps shared libraries that its packages need and the system lacks."""
    return python.parent.parent / "system"
