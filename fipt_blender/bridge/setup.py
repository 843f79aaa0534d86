"""The add-on's set-up as a child process, which makes the engine's environment and reports in messages.

It runs in Blender's Python but in its own process: the window stays responsive, and cancelling it ends pip
too. Standard library only.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..core.device.cuda import cuda_devices, cuda_driver_version
from ..core.run.errors import FiptError, Problem, problem
from ..core.run.lock import hold
from ..core.run.messages import Reporter, claim_stdout
from ..core.run.runfolder import RunFolder, explained_write_errors
from . import pins
from .environment import VERSION, set_up
from .interpreter import answer
from .places import environment_python
from .plan import Plan, plan_key
from .torch_build import choose_torch_build

_WEIGHTS = (5.0, 120.0, 10.0, 15.0)  # expected seconds of the stages of `set_up`


class SetupReporter(Reporter):
    """A reporter that can change the text of the current stage."""

    def stage(self, name: str, text: str) -> None:
        """Begin the next planned stage."""
        self._name = name
        super().stage(name, text)

    def detail(self, text: str) -> None:
        """Describe what the current stage is doing."""
        place = {"index": self._stage, "count": len(self._weights)}
        self._write({"type": "stage", "name": self._name, **place, "text": text})

    def log(self, line: str) -> None:
        """Write a line of pip's output to the log."""
        print(line, file=sys.stderr, flush=True)


def make_plans(data: Path, device: str, wheels: Path | None) -> list[Plan]:
    """The environments that can be used, best first: those that exist, this Python's, those of other Pythons.

    Args:
        data: the data folder.
        device: the preference: "auto", "cuda" or "llvm".
        wheels: folder from which packages are installed; None: from the network.

    Raises:
        FiptError: ``python-unfit`` or ``wheels-missing`` if no Python is suitable.
    """
    groups = pins.read_pins()
    torch = "" if wheels else choose_torch_build(device, cuda_driver_version(), cuda_devices())
    versions: Sequence[pins.Version] = pins.ENGINE_PYTHONS
    if wheels is not None:
        versions = pins.wheel_pythons(wheels, groups)
        if not versions:
            raise FiptError("wheels-missing.make-plans", wheels=wheels)
    key = plan_key(groups["engine"], groups.get("lock", []), torch)
    # An environment that another Blender's Python has made is as good as one of this Python.
    existing = pins.managed_environments(data)
    bases = [environment_python(folder) for folder in existing if pins.is_set_up(folder, key)]
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
                lock=groups.get("lock", []),
                key=key,
                wheels=wheels,
                torch=torch,
            )
            plans.setdefault(folder.name, plan)
    if not plans:
        listed = " or ".join(f"{major}.{minor}" for major, minor in versions)
        source = "The wheels are" if wheels else "The engine's packages exist"
        raise FiptError("python-unfit.make-plans", source=source, listed=listed)
    return list(plans.values())


def other_pythons() -> Iterator[Path]:
    """Pythons on the search path in which the engine can run, the newest first."""
    for version in sorted(pins.ENGINE_PYTHONS, reverse=True):
        names = [f"python{version[0]}.{version[1]}", "python3", "python"]
        found = dict.fromkeys(filter(None, map(shutil.which, names)))
        yield from [path for path in map(Path, found) if python_version(path) == version][:1]


def python_version(python: Path) -> pins.Version | None:
    """The version of a Python; None if it does not start."""
    major, _, minor = (answer(python, VERSION) or "").partition(" ")
    return (int(major), int(minor)) if major.isdigit() and minor.isdigit() else None


def run(arguments: argparse.Namespace, reporter: SetupReporter) -> None:
    """Make the best environment that can be made, unless there is one already.

    ``data`` of the message ``done``: ``folder``, ``python`` and ``torch``, PyTorch's build.

    Raises:
        FiptError: what is wrong and what to do.
    """
    with explained_write_errors(arguments.data):
        arguments.data.mkdir(parents=True, exist_ok=True)
    with hold(RunFolder(arguments.data), ["set-up"]):
        *others, last = make_plans(arguments.data, arguments.device, arguments.wheels)
        for plan in (*others, last):
            reporter.plan(_WEIGHTS)
            try:
                set_up(plan, reporter)
            except FiptError as error:
                if error.code != "python-unfit" or plan is last:
                    raise
                reporter.warn(Problem(error.code, error.text, "Another Python will be tried."))
                continue
            data = {"folder": str(plan.folder), "python": str(plan.python), "torch": plan.torch}
            reporter.done([str(plan.python)], data)
            return


def main() -> int:
    """Run set-up; returns 0, or 1 after an error message."""
    parser = argparse.ArgumentParser(prog="fipt_blender.bridge.setup", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--device", choices=("auto", "cuda", "llvm"), default="auto")
    parser.add_argument("--wheels", type=Path)
    arguments = parser.parse_args()
    reporter = SetupReporter(claim_stdout())
    try:
        run(arguments, reporter)
    except FiptError as error:
        traceback.print_exc()
        reporter.error(error)
        return 1
    except Exception as error:  # every failure must reach the user
        traceback.print_exc()
        reporter.error(problem("setup-failed", kind=type(error).__name__, error=error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
