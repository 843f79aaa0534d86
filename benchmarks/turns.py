# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimations in processes of their own that take turns stage by stage, and the records of what they cost."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fipt_blender.bridge.interpreter import engine_environment
from fipt_blender.core.job.errors import FiptError
from fipt_blender.core.job.runfolder import RunFolder


def tell(text: str) -> None:
    """Say on stderr what happens now."""
    print(text, file=sys.stderr, flush=True)


class Turn:
    """One estimation in a process that waits before each stage.

    Args:
        name: of the configuration.
        run: its run folder.
        last: stage that nothing follows; None for all.
    """

    def __init__(self, name: str, run: RunFolder, last: str | None = None) -> None:
        self._name, self._log = name, run.log
        script = Path(__file__).resolve().parent / "speed_engine.py"
        with open(run.log, "ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(script), str(run.root), name, *([] if last is None else [last])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=engine_environment(Path(sys.executable)),
                text=True,
            )

    def read(self) -> dict[str, Any]:
        """The next message; waits for it.

        Raises:
            FiptError: ``run-failed`` where the process ends without one.
        """
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise FiptError("run-failed", f"The {self._name} run failed.", f"{self._log} tells why.")
        return json.loads(line)

    def permit(self) -> None:
        """Let the stage begin that is ready."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write("go\n")
            self.process.stdin.flush()
        except BrokenPipeError:  # it died; `read` tells
            pass


def take_turns(runs: Mapping[str, RunFolder], last: str | None = None) -> dict[str, dict[str, Any]]:
    """Run estimations side by side, one stage of one of them at a time; a record of each.

    Args:
        last: stage that nothing follows; None for all.

    Raises:
        FiptError: ``run-failed``.
    """
    turns: dict[str, Turn] = {}
    records: dict[str, dict[str, Any]] = {name: {"seconds": 0.0, "cpu_seconds": 0.0} for name in runs}
    ready: dict[str, str] = {}

    def hear(name: str) -> None:
        message = turns[name].read()
        for key in ("seconds", "cpu_seconds"):
            records[name][key] += message[key]
        if "done" in message:
            records[name]["stages"] = message["done"]["stages"]
            del ready[name]
        else:
            ready[name] = message["ready"]

    try:
        for name, run in runs.items():
            turns[name] = Turn(name, run, last)
            hear(name)
        while ready:
            for name in list(ready):
                tell(f"{name}: {ready[name]}")
                turns[name].permit()
                hear(name)
    finally:
        for turn in turns.values():
            if turn.process.poll() is None:
                if turn.process.stdin is not None:
                    turn.process.stdin.close()  # one that waits ends by itself
                if ready:
                    turn.process.terminate()
                turn.process.wait()
    return records


def merged(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """One record of several runs: the least seconds, which other work disturbed least, and the median.

    Beside the stages stands what lies between them ("other": loading, previews, results).
    """
    runs = []
    for record in records:
        stages = [dict(stage) for stage in record["stages"]]
        spent = {key: sum(stage[key] for stage in stages) for key in ("seconds", "cpu_seconds")}
        other = {key: round(max(record[key] - value, 0.0), 2) for key, value in spent.items()}
        runs.append([*stages, {"name": "other", **other}])
    merged_stages = []
    for same in zip(*runs, strict=True):
        stage = dict(same[0])
        for key in ("seconds", "cpu_seconds"):
            stage[key] = min(each[key] for each in same)
            stage[f"median_{key}"] = statistics.median(each[key] for each in same)
        if stage.get("rays") and stage["seconds"]:
            stage["mrays_per_second"] = round(stage["rays"] / stage["seconds"] / 1e6, 3)
        merged_stages.append(stage)
    total = {
        key: round(sum(stage[key] for stage in merged_stages), 2)
        for key in ("seconds", "cpu_seconds", "median_seconds", "median_cpu_seconds")
    }
    peaks = {
        key: max((stage.get(key, 0.0) for stage in merged_stages), default=0.0)
        for key in ("peak_memory_gb", "peak_own_gb")
    }
    return {**total, "repeats": len(records), **peaks, "stages": merged_stages}
