# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One estimation that waits for permission before each stage, so that two estimations can take turns.

python benchmarks/speed_engine.py RUN reference|shipped [LAST]: prints, one JSON object per line, {"ready":
stage} before each stage and {"done": summary} at the end, each with the time spent since the last line. A
line on stdin starts the stage. The process ends after the stage LAST.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.own_memory import watched
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.chain import Chain, Watch
from fipt_blender.core.run.messages import Reporter, claim_stdout, peak_memory_gb
from fipt_blender.core.run.runfolder import RunFolder

# Pixels whose shadings are saved after stages 1 and 3; some thousand of them are usable.
KEPT_PIXELS = 20_000
_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def kept_pixels(count: int) -> np.ndarray:
    """(M,) int64 pixels, of `count`, whose shadings are saved; the same in both configurations."""
    if count <= KEPT_PIXELS:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, KEPT_PIXELS, replace=False))


def kept_path(run: RunFolder, stage: str) -> Path:
    """File of the shadings saved after a stage."""
    return run.root / "speed" / f"{stage}.npz"


def reset_peak() -> None:
    """Reset the peak memory of this process, if the system supports it."""
    with contextlib.suppress(OSError):
        _RESET.write_text("5")


def stage_peak_gb() -> float:
    """Peak resident memory in GB since the last reset, or since the start if it can't be reset."""
    if _STATUS.exists():
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e9
    return peak_memory_gb()


class Pace:
    """Waits for permission before each stage and measures the time in between.

    Args:
        stream: for the messages.
        permission: contains a line for each permitted stage.
    """

    def __init__(self, stream: IO[str], permission: IO[str]) -> None:
        self._stream, self._permission = stream, permission
        self._started, self._cpu = 0.0, 0.0

    def wait(self, stage: str) -> None:
        """Report that a stage is ready and wait until it may begin."""
        self.tell({"ready": stage})
        if not self._permission.readline():
            raise SystemExit("stdin was closed")
        self.restart()

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message with the seconds spent since the last permission."""
        spent = {"seconds": time.monotonic() - self._started, "cpu_seconds": time.process_time() - self._cpu}
        self._stream.write(json.dumps({**message, **spent}) + "\n")
        self._stream.flush()

    def restart(self) -> None:
        """Restart the measurement."""
        self._started, self._cpu = time.monotonic(), time.process_time()

    def aside(self, work: Callable[[], None]) -> None:
        """Do work that is not measured."""
        before = time.monotonic(), time.process_time()
        work()
        self._started += time.monotonic() - before[0]
        self._cpu += time.process_time() - before[1]


class LastStage(Exception):
    """Ends an estimation after the requested last stage."""


class Paced(Watch):
    """Waits before each stage, measures it and saves some shadings; raises :class:`LastStage` after the last.

    Args:
        run: its folder. chain: of the stages.
        pace: is waited for.
        last: name of the last stage; None: all.

    Attributes:
        spent: facts of each stage, by its name.
    """

    def __init__(self, run: RunFolder, chain: Chain, pace: Pace, last: str | None = None) -> None:
        self.spent: dict[str, dict[str, float]] = {}
        self._run, self._chain, self._pace, self._last = run, chain, pace, last
        self._stack = contextlib.ExitStack()

    def before(self, name: str) -> None:
        """Wait, and begin to measure."""
        self._pace.wait(name)
        reset_peak()
        self._cpu = time.process_time()
        self._own_peak_gb = self._stack.enter_context(watched())

    def after(self, name: str, new: bool) -> None:
        """End the measurement."""
        found = {
            "cpu_seconds": round(time.process_time() - self._cpu, 2),
            "peak_memory_gb": round(stage_peak_gb(), 3),
            "peak_own_gb": round(self._own_peak_gb(), 3),
        }
        self._stack.close()
        self.spent[name] = found
        if name == "shadings" or name.startswith("refinement-"):
            self._pace.aside(lambda: self._keep(name))
        if name == self._last:
            raise LastStage

    def _keep(self, name: str) -> None:
        store, levels, scale = (self._chain.value(each, name) for each in ("shadings", "levels", "scale"))
        rows = kept_pixels(len(store.diffuse))
        path = kept_path(self._run, name)
        path.parent.mkdir(exist_ok=True)
        stored = (np.asarray(array[rows], np.float32) for array in (store.diffuse, store.specular))
        diffuse, specular = (values * np.float32(scale) for values in stored)
        np.savez(path, rows=rows, levels=levels, diffuse=diffuse, specular=specular)


def main(argv: list[str]) -> int:
    """Run the estimation of the run folder argv[0] in the configuration argv[1], up to the stage argv[2]."""
    folder, name = RunFolder(argv[0]), argv[1]
    pace = Pace(claim_stdout(), sys.stdin)
    pace.restart()
    settings = folder.read()
    set_variant(settings.device)
    from fipt_blender.core.estimate.estimation import chain_of, finish, stages_of
    from fipt_blender.core.estimate.input import prepare_input
    from fipt_blender.core.optics.brdf import set_masking

    set_masking(settings.masking)
    reporter = Reporter()
    given = prepare_input(folder, settings, reporter)
    stages = stages_of(given)
    if name == "reference":
        from benchmarks.reference import reference_pipeline

        stages = reference_pipeline(settings.rounds)
    chain = chain_of(given, stages, reporter)
    watch = Paced(folder, chain, pace, argv[2] if len(argv) > 2 else None)
    statistics: dict[str, Any] = {}
    with contextlib.suppress(LastStage):
        statistics = finish(given, chain, watch, reporter)
    listed = [stage | watch.spent.get(stage["name"], {}) for stage in chain.facts()]
    pace.tell({"done": {"peak_memory_gb": round(peak_memory_gb(), 3), **statistics, "stages": listed}})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
