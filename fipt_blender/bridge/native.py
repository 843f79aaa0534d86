"""Fetching the system libraries and the LLVM that an environment needs. Standard library only."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from ..core.run.errors import FiptError
from ..core.run.messages import parse_message
from . import provision
from .interpreter import engine_command, output_end, run_quietly, system_folder
from .pip import Pip, Teller
from .plan import Plan

LLVM_LIBRARIES = ("libLLVM", "libc++", "libunwind")  # how the names of the files that are kept begin


def provide_system_libraries(plan: Plan, tell: Teller) -> None:
    """Fetch libraries that packages need and a minimal Linux lacks (bpy: a desktop's; Dr.Jit: libatomic).

    Raises:
        FiptError: ``package-broken``.
    """
    if not (failure := import_failure(plan)):
        return
    names: list[str] = []
    if sys.platform == "linux" and "cannot open shared object file" in failure and plan.wheels is None:
        tell.detail("Fetching missing system libraries")
        with provision.DebianPackages() as debian:
            names = debian.missing(provision.DEBIAN_LIBRARIES) if debian.available else []
            root = debian.unpack(names) if names else None
            if root is not None:
                provision.copy_libraries(root, system_folder(plan.python))
        failure = import_failure(plan)
    if failure:
        how = f"As root: apt-get install {' '.join(names)}" if names else "Install the missing library."
        raise FiptError("package-broken", failure=failure, how=how)


def import_failure(plan: Plan) -> str:
    """Import each of the plan's modules in its own process; returns the first failure, or ""."""
    for module in plan.modules:
        result = run_quietly([str(plan.python), "-I", "-c", f"import {module}"], plan.python)
        if result.returncode != 0:
            return output_end(result)
    return ""


def provide_llvm(plan: Plan, tell: Teller) -> str | None:
    """Find an LLVM that works, or else fetch the pinned package.

    Returns:
        Its path; None if a GPU is used instead.

    Raises:
        FiptError: ``llvm-missing``, ``package-hash``, or the error of the engine's check.
    """
    data, problem = check_engine(plan.python)
    if not data.get("device"):
        tell.detail("No working LLVM was found; fetching one")
        folder = plan.folder / "llvm"
        shutil.rmtree(folder, ignore_errors=True)
        if _fetch_llvm_package(plan, folder, tell):
            data, _ = check_engine(plan.python)
    if not data.get("device"):
        raise problem
    return data["llvm"]


def check_engine(python: Path) -> tuple[dict[str, Any], FiptError]:
    """The data of the engine's `check`, and its most important warning or error."""
    result = run_quietly(engine_command(python, "check"), python)
    messages = [message for line in result.stdout.splitlines() if (message := parse_message(line))]
    problems = [message for message in messages if message["type"] in ("warning", "error")]
    problems.sort(key=lambda message: message["code"] != "llvm-missing")
    data: dict[str, Any] = next((message["data"] for message in messages if message["type"] == "done"), {})
    if problems:
        return data, FiptError.of(problems[0]["code"], problems[0]["text"], problems[0]["remedy"])
    return data, FiptError("engine-failed", output_end=output_end(result))


def _fetch_llvm_package(plan: Plan, folder: Path, tell: Teller) -> bool:
    """Take LLVM's libraries out of the pinned wheel; returns whether the platform has one.

    Raises:
        FiptError: ``package-hash``.
    """
    if not plan.llvm:
        return False
    with tempfile.TemporaryDirectory() as temporary:
        try:
            pip = Pip(plan.python, plan.wheels, tell)
            pip.run_locked(plan.llvm, "download", "--dest", temporary, expected_gb=0.1)
        except FiptError as error:
            if error.code == "package-hash":
                raise
        wheels = Path(temporary).glob("*.whl")
        return any([provision.wheel_libraries(wheel, folder, LLVM_LIBRARIES) for wheel in wheels])
