"""The Python that runs the engine, its command line and its environment. Standard library only."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ..core.run.errors import FiptError
from ..core.run.process_identity import BLENDER_VARIABLE, running_blender
from .pins import managed_environments
from .places import PACKAGE_FOLDER, default_data_folder, environment_python

PYTHON_VARIABLE = "FIPT_ENGINE_PYTHON"

_HAS_PACKAGES = """
import importlib.util, sys
wanted = ("mitsuba", "torch", "OpenEXR", "OpenImageIO")
missing = [name for name in wanted if importlib.util.find_spec(name) is None]
print(sys.version.split()[0], "lacks " + ", ".join(missing) if missing else "has all")
sys.exit(1 if missing else 0)
"""


def find_engine_python(explicit: str | None = None, managed: Sequence[Path] | None = None) -> Path:
    """The interpreter that runs the engine.

    An interpreter that the user names (by the argument or by $FIPT_ENGINE_PYTHON) is used, or it is an error.
    Otherwise the first of these that has the packages is used: the managed environments, the checkout's
    ``.venv`` beside the package, and the running interpreter (Blender as a Python module).

    Args:
        explicit: an interpreter or the folder of a virtual environment.
        managed: folders of the environments that the add-on has made, best first; None: those in the user's
            data folder.

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
                "engine-missing.find-engine-python-2", source=source, python=python, reason=reason
            )
        return python
    if managed is None:
        managed = managed_environments(default_data_folder())
    candidates = [environment_python(folder) for folder in (*managed, PACKAGE_FOLDER.parent / ".venv")]
    for python in (*candidates, Path(sys.executable or "python")):
        if _why_not(python) is None:
            return python
    raise FiptError("engine-missing.find-engine-python")


def _why_not(python: Path) -> str | None:
    """Why an interpreter can't run the engine; None if it can. The packages are looked up, not imported."""
    if not python.is_file():
        return "there is no such file"
    result = run_quietly([str(python), "-I", "-c", _HAS_PACKAGES], python, timeout=60.0)
    return None if result.returncode == 0 else (result.stdout.strip() or output_end(result))[-200:]


def run_quietly(
    command: list[str], python: Path | None = None, timeout: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command and keep its output; one that can't be started or takes too long has status 127.

    Args:
        command: to run.
        python: the engine's interpreter if the command needs the libraries of its environment.
        timeout: seconds.
    """
    try:
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            env=engine_environment(python),
            timeout=timeout,
            check=False,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # else Windows opens a console
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(command, 127, "", f"It does not start ({error}).")


def output_end(result: subprocess.CompletedProcess[str]) -> str:
    """The end of the output of a failed child process."""
    text = (result.stderr.strip() or result.stdout.strip())[-600:]
    return text or f"{' '.join(result.args)} ended with status {result.returncode}"


def answer(python: Path, code: str) -> str | None:
    """The output of a line of code in a Python, stripped; None if the Python or the code fails."""
    if not python.is_file():
        return None
    result = run_quietly([str(python), "-I", "-c", code])
    return result.stdout.strip() if result.returncode == 0 else None


def engine_command(python: Path, *args: str) -> list[str]:
    """The command line of one engine command, e.g. ``engine_command(python, "check")``."""
    return package_command(python, "fipt_blender.core", *args)


def package_command(python: Path, module: str, *args: str) -> list[str]:
    """The command line that runs a module of this package as a program in a Python.

    With -I neither the working directory nor the user's site folder is on its path.
    """
    return [str(python), "-I", "-X", "utf8", str(PACKAGE_FOLDER / "bridge" / "start.py"), module, *args]


def setup_command(python: Path, data: Path, device: str, wheels: Path | None) -> list[str]:
    """The command line of set-up.

    Args:
        python: Blender's Python, with which the environment is made if possible.
        data: the data folder, for the environment.
        device: the preference; it determines the build of PyTorch.
        wheels: folder from which packages are installed; None: from the network.
    """
    source = [] if wheels is None else [f"--wheels={wheels}"]
    return package_command(python, "fipt_blender.bridge.setup", str(data), f"--device={device}", *source)


def engine_environment(python: Path | None = None) -> dict[str, str]:
    """Environment variables of the engine: the caller's, without those that affect Python.

    Idle OpenMP threads sleep instead of spinning, since torch and Dr.Jit take turns on the same cores.

    Args:
        python: the engine's interpreter; the child finds the libraries of its `system_folder`.
    """
    environment = {key: value for key, value in os.environ.items() if not key.upper().startswith("PYTHON")}
    if "bpy" in sys.modules:  # else the engine's own environment may have it as a module
        environment.setdefault(BLENDER_VARIABLE, running_blender())
    environment.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    environment.setdefault("KMP_BLOCKTIME", "0")
    if python is not None and sys.platform == "linux" and (folder := system_folder(python)).is_dir():
        paths = [str(folder), *environment.get("LD_LIBRARY_PATH", "").split(":")]
        environment["LD_LIBRARY_PATH"] = ":".join(dict.fromkeys(path for path in paths if path))
    return environment


def system_folder(python: Path) -> Path:
    """The folder of an environment for shared libraries that its packages need and the system lacks."""
    return python.parent.parent / "system"
