# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimations in separate processes that take turns stage by stage, and records of their costs."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fipt_blender.bridge.interpreter import engine_environment
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder


def tell(text: str) -> None:
    """Print a line of progress to stderr."""
    print(text, file=sys.stderr, flush=True)


class Turn:
    """One estimation in a process that waits before each stage.

    Args:
        name: of the configuration.
        run: its run folder.
        last: the last stage; None: all stages.
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
        """Wait for the next message.

        Raises:
            FiptError: ``run-failed`` if the process ends without one.
        """
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise FiptError("run-failed", f"The {self._name} run failed.", f"See {self._log}.")
        return json.loads(line)

    def permit(self) -> None:
        """Permit the stage that is ready."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write("go\n")
            self.process.stdin.flush()
        except BrokenPipeError:  # the process has died; `read` reports that
            pass


def take_turns(runs: Mapping[str, RunFolder], last: str | None = None) -> dict[str, dict[str, Any]]:
    """Run several estimations, one stage of one of them at a time; returns a record of each by name.

    Args:
        runs: run folder by name of the configuration.
        last: the last stage; None: all stages.

    Raises:
        FiptError: ``run-failed``.
    """
    turns: dict[str, Turn] = {}
    records: dict[str, dict[str, Any]] = {name: {"seconds": 0.0, "cpu_seconds": 0.0} for name in runs}
    ready: dict[str, str] = {}

    def receive(name: str) -> None:
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
            receive(name)
        while ready:
            for name in list(ready):
                tell(f"{name}: {ready[name]}")
                turns[name].permit()
                receive(name)
    finally:
        for turn in turns.values():
            if turn.process.poll() is None:
                if turn.process.stdin is not None:
                    turn.process.stdin.close()  # a process that waits then ends
                if ready:
                    turn.process.terminate()
                turn.process.wait()
    return records


def merged(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """One record of several runs: minimum (least disturbed by other work) and median of the seconds.

    The time between the stages (loading, previews, results) becomes a stage named "other".
    """
    runs = []
    for record in records:
        stages = [dict(stage) for stage in record["stages"]]
        spent = {key: sum(stage[key] for stage in stages) for key in ("seconds", "cpu_seconds")}
        other = {key: round(max(record[key] - value, 0.0), 2) for key, value in spent.items()}
        runs.append([*stages, {"name": "other", **other}])
    merged_stages = []
    for repeats in zip(*runs, strict=True):
        stage = dict(repeats[0])
        for key in ("seconds", "cpu_seconds"):
            stage[key] = min(repeat[key] for repeat in repeats)
            stage[f"median_{key}"] = statistics.median(repeat[key] for repeat in repeats)
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
