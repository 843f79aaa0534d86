"""The real engine commands in this process, where what is tested is what Blender's side does with their answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from fipt_blender.bridge.process import EngineProcess
from fipt_blender.core import __main__ as engine
from fipt_blender.core.device import variant
from fipt_blender.core.run.messages import Reporter
from fipt_blender.jobs import run_job

NOBODY = 2**30  # no process has this id


class EngineHere(EngineProcess):
    """An engine command that has ended when this object is made; its messages are still to be read."""

    def _start(self, command: Sequence[str], environment: Mapping[str, str] | None) -> Any:
        with open(self._messages, "w", encoding="utf-8") as stream:
            engine.run_command(command[command.index(engine.__package__) + 1 :], Reporter(stream))
        return SimpleNamespace(pid=NOBODY, poll=lambda: 0, returncode=0)

    def _signal(self, terminate: bool) -> None:
        pass


def start_here(command: Sequence[str], *arguments: Any) -> EngineProcess:
    """Commands of the engine run here; stand-ins for them are processes."""
    return (EngineHere if engine.__package__ in command else EngineProcess)(command, *arguments)


@contextmanager
def engine_here() -> Iterator[None]:
    """Jobs on run folders call the engine instead of starting a process, which takes a second or more.

    Mitsuba's variant stays that of the tests, whatever device a job asks for.
    """
    with pytest.MonkeyPatch.context() as patches:
        for device in variant.VARIANTS:
            patches.setitem(variant.VARIANTS, device, variant.set_variant())
        patches.setattr(run_job, "EngineProcess", start_here)
        yield


@contextmanager
def hardly_training() -> Iterator[None]:
    """Estimations in this process take hardly a step towards the closed form."""
    with pytest.MonkeyPatch.context() as patches:
        for module in ("material.training", "estimate.training_stages"):
            patches.setattr(f"fipt_blender.core.{module}.PRETRAINING_STEPS", 4)
        yield
