"""The description of an environment that set-up makes. Standard library only."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .places import environment_python

# Packages with native code that the engine imports.
ENGINE_MODULES = ("mitsuba", "torch", "OpenEXR", "OpenImageIO", "pycolmap", "pyoidn")


@dataclass(frozen=True)
class Plan:
    """An environment that is to be made.

    Attributes:
        folder: of the environment; its parent need not exist.
        base: the interpreter with which it is made.
        requirements: the pinned packages.
        modules: to be imported at the end, each in its own process, as a test.
        llvm: the package that contains LLVM, for machines that have none; with its hashes, without which it
            is not fetched.
        pip: the pin of pip itself, with its hashes likewise.
        lock: all packages but PyTorch with hashes (`pins.read_pins`); empty: what the requirements need is
            installed in the versions that pip chooses.
        key: what the requirements depend on (`plan_key`); set-up starts anew when it changes.
        wheels: folder from which packages are installed; None: from the network.
        torch: the build of PyTorch, a key of `torch_build.SIZES`; "" is the package index's own build.
    """

    folder: Path
    base: Path
    requirements: Sequence[str]
    modules: Sequence[str] = ENGINE_MODULES
    llvm: Sequence[str] = ()
    pip: Sequence[str] = ()
    lock: Sequence[str] = ()
    key: str = ""
    wheels: Path | None = None
    torch: str = ""

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return environment_python(self.folder)


def plan_key(*facts: Any) -> str:
    """Key of what an environment depends on besides its folder; `facts` are JSON-serialisable."""
    return json.dumps([*facts, platform.machine(), sys.platform], sort_keys=True)
