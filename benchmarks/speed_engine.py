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


def paced(kind: type, pace: Pace, last: str | None = None) -> type:
    """A subclass of an estimation that waits before each stage, measures it and saves some shadings.

    After the stage `last` it raises :class:`LastStage`.
    """

    class Paced(kind):  # type: ignore[misc, valid-type]
        def _stage(
            self, name: str, text: str, work: Callable[[], dict[str, Any]], load: Callable[[], None]
        ) -> None:
            pace.wait(name)

            def measured() -> dict[str, Any]:
                reset_peak()
                cpu = time.process_time()
                with watched() as own_peak_gb:
                    facts = work()
                    peaks = {"peak_memory_gb": stage_peak_gb(), "peak_own_gb": own_peak_gb()}
                spent = {"cpu_seconds": round(time.process_time() - cpu, 2)}
                return facts | spent | {name: round(peak, 3) for name, peak in peaks.items()}

            super()._stage(name, text, measured, load)
            if name == "shadings" or name.startswith("refinement-"):
                pace.aside(lambda: self._keep(name))
            if name == last:
                raise LastStage

        def _keep(self, name: str) -> None:
            rows = kept_pixels(len(self.pixels))
            store = self._open_shadings()
            path = kept_path(self.folder, name)
            path.parent.mkdir(exist_ok=True)
            stored = (np.asarray(array[rows], np.float32) for array in (store.diffuse, store.specular))
            diffuse, specular = (values * np.float32(self.scale) for values in stored)
            np.savez(path, rows=rows, levels=self.levels, diffuse=diffuse, specular=specular)

    return Paced


def main(argv: list[str]) -> int:
    """Run the estimation of the run folder argv[0] in the configuration argv[1], up to the stage argv[2]."""
    folder, name = RunFolder(argv[0]), argv[1]
    pace = Pace(claim_stdout(), sys.stdin)
    pace.restart()
    settings = folder.read()
    set_variant(settings.device)
    from fipt_blender.core.estimate.input import prepare_input
    from fipt_blender.core.optics.brdf import set_masking

    set_masking(settings.masking)
    if name == "reference":
        from benchmarks.reference import ReferenceEstimation as Kind
    else:
        from fipt_blender.core.estimate.stages import Estimation as Kind  # type: ignore[assignment]
    reporter = Reporter()
    last = argv[2] if len(argv) > 2 else None
    estimation = paced(Kind, pace, last)(prepare_input(folder, settings, reporter), reporter)
    with contextlib.suppress(LastStage):
        estimation.run()
    pace.tell({"done": estimation.summary()})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
