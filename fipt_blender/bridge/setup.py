# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's set-up as a child process of its own: makes the engine's environment, telling in messages.

It runs in Blender's Python, so that the window stays free and a cancelled one takes pip with it.
Standard library only.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from ..core.device.cuda import cuda_devices, cuda_driver_version
from ..core.job.errors import FiptError
from ..core.job.lock import hold
from ..core.job.messages import Reporter, claim_stdout
from ..core.job.runfolder import RunFolder, explained_write_errors
from . import pins
from .environment import Plan, other_pythons, plan_key, python_version, set_up
from .places import environment_python
from .torch_build import choose_torch_build

_WEIGHTS = (5.0, 120.0, 10.0, 15.0)  # seconds of the stages of `set_up`


class _Teller(Reporter):
    """A reporter whose running stage can change its text."""

    def stage(self, name: str, text: str) -> None:
        """Begin the next planned stage."""
        self._name = name
        super().stage(name, text)

    def detail(self, text: str) -> None:
        """Say what the running stage does now."""
        place = {"index": self._stage, "count": len(self._weights)}
        self._write({"type": "stage", "name": self._name, **place, "text": text})

    def log(self, line: str) -> None:
        """Keep a line of pip's output."""
        print(line, file=sys.stderr, flush=True)


def make_plans(data: Path, device: str, wheels: Path | None) -> list[Plan]:
    """The environments that would do, best first: this Python's, then those of other Pythons found.

    Raises:
        FiptError: ``python-unfit`` or ``wheels-missing`` where no Python fits.
    """
    groups = pins.read_pins()
    torch = "" if wheels else choose_torch_build(device, cuda_driver_version(), cuda_devices())
    versions: Sequence[pins.Version] = pins.ENGINE_PYTHONS
    if wheels is not None:
        versions = pins.wheel_pythons(wheels, groups)
        if not versions:
            raise FiptError(
                "wheels-missing",
                f"The folder {wheels} does not hold the wheels that this version needs.",
                "Fill it with the command that Copy Download Command gives, on a machine with network.",
            )
    key = plan_key(groups["engine"], torch)
    # One that another Blender's Python has made serves as well as one of this Python.
    made = pins.managed_environments(data)
    bases = [environment_python(folder) for folder in made if pins.is_set_up(folder, key)]
    plans: dict[str, Plan] = {}
    for base in (*bases, Path(sys.executable), *other_pythons()):
        version = python_version(base)
        if version is not None and version in versions:
            folder = data / pins.environment_name(groups, version)
            plan = Plan(
                folder=folder,
                base=base,
                requirements=groups["engine"],
                llvm=groups["llvm"],
                pip=groups["pip"],
                key=key,
                wheels=wheels,
                torch=torch,
            )
            plans.setdefault(folder.name, plan)
    if not plans:
        listed = " or ".join(f"{major}.{minor}" for major, minor in versions)
        source = "The wheels are" if wheels else "The engine's packages exist"
        raise FiptError(
            "python-unfit",
            f"{source} for Python {listed}, and this machine has none of them.",
            f"Install Python {listed} from your system or from the Python project, and set up again.",
        )
    return list(plans.values())


def run(arguments: argparse.Namespace, reporter: _Teller) -> None:
    """Make the best environment that can be made, or leave one that stands.

    ``data`` of the closing message: ``folder``, ``python`` and ``torch``, PyTorch's build.

    Raises:
        FiptError: what is wrong and what to do.
    """
    with explained_write_errors(arguments.data):
        arguments.data.mkdir(parents=True, exist_ok=True)
    with hold(RunFolder(arguments.data), ["set-up"]):
        make_first(make_plans(arguments.data, arguments.device, arguments.wheels), reporter)


def make_first(plans: Sequence[Plan], reporter: _Teller) -> None:
    """Make the first of these environments whose Python is fit for it.

    Raises:
        FiptError: what is wrong and what to do.
    """
    for last, plan in enumerate(plans, 1 - len(plans)):
        reporter.plan(_WEIGHTS)
        try:
            set_up(plan, reporter)
        except FiptError as error:
            if error.code != "python-unfit" or last == 0:
                raise
            reporter.warning(error.code, error.text, "Another Python is tried.")
            continue
        data = {"folder": str(plan.folder), "python": str(plan.python), "torch": plan.torch}
        reporter.done([str(environment_python(plan.folder))], data)
        return


def main() -> int:
    """Run set-up; 0, or 1 after an error message."""
    parser = argparse.ArgumentParser(prog="fipt_blender.bridge.setup", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--device", choices=("auto", "cuda", "llvm"), default="auto")
    parser.add_argument("--wheels", type=Path)
    arguments = parser.parse_args()
    reporter = _Teller(claim_stdout())
    try:
        run(arguments, reporter)
    except FiptError as error:
        traceback.print_exc()
        reporter.error(error.code, error.text, error.remedy)
        return 1
    except Exception as error:  # the last net: the window must learn of any failure
        traceback.print_exc()
        text = f"Set-up failed: {type(error).__name__}: {error}"
        reporter.error("setup-failed", text, "The log tells more; please report it.")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
