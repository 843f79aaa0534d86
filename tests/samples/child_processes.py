"""For tests of child processes: whether one is alive, and waiting for a condition."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

PATIENCE_SECONDS = 300.0  # no bound on speed: after it a test counts as one that hangs
# A program that ends only when it is told to, long after all patience.
SLEEPER = "import time; time.sleep(3600)"
# Works in a run folder until the file "stop" appears; holds the lock as the engine does.
ENGINE = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from fipt_blender.core.run.errors import Problem
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.messages import Reporter, claim_stdout
from fipt_blender.core.run.runfolder import RunFolder
run, reporter = RunFolder(sys.argv[2]), Reporter(claim_stdout())
with hold(run, ["estimate", str(run.root)]):
    reporter.stage("shadings", "Baking")
    reporter.progress(0.4, force=True, pictures=["stage/picture.png"])
    reporter.warn(Problem("odd", "Odd.", "Even it."))
    while not (run.root / "stop").exists():
        time.sleep(0.02)
    print("a stray line")
    reporter.done([], {})
"""

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and process groups")


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().rsplit(")", 1)[1].split()[0] != "Z"


def frozen_clock(seconds: float = 0.0) -> SimpleNamespace:
    """Stands for the module `time`: always so many seconds after the system's start; nobody may sleep."""
    return SimpleNamespace(monotonic=lambda: seconds, sleep=lambda _: pytest.fail("it waits"))


def wait_for(true: Callable[[], object], pause: float = 0.02) -> None:
    """Wait until a condition holds, on a busy machine too; fail where it never does."""
    end = time.monotonic() + PATIENCE_SECONDS
    while not true():
        if time.monotonic() > end:
            pytest.fail(f"the condition does not hold after {PATIENCE_SECONDS:.0f} seconds")
        time.sleep(pause)
