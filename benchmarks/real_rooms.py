# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Real rooms, of which no ground truth exists: how well photographs that were held back are re-rendered.

    python benchmarks/real_rooms.py FOLDER ... --output DIR [--preset draft]
    python benchmarks/real_rooms.py --run RUN ...

Protocol. A capture is read as a new user would: `estimate FOLDER` with a preset and nothing else; where it
says that there are no cameras, `prepare` first, and where there is no mesh, `--mesh-from-photographs`. Views
are held back by the capture's own split, else every eighth by name; at most eight of them, evenly spread, are
judged, at the size at which light was solved. They are withheld from all stages, the exposure and response of
the others included. *Render*: paths traced from
the estimate alone (materials, lamps, environment; 32 a pixel, at most 8 surfaces, denoised). *Projection*:
the training photographs that see a pixel's point on the same mesh, weighted by direction and distance; unseen
pixels take the nearest seen one. Each picture gets one factor of exposure, for all channels, the median over
pixels that are not clipped. Photographs that are not HDR are compared in their own codes, through the
response that was found; HDR ones clipped to [0, 1] with the capture's median at 0.18 and gamma 1 / 2.2.
*Pooled*: PSNR of the mean squared error over all pixels and channels of all judged views, holes of the mesh
included. *EAG-PT's way*: mean over views and channels of one PSNR each. Nothing of a capture is stored here.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.result_contents import Emitters, QualityFigures
from fipt_blender.core.run.runfolder import RunFolder

PRODUCT = Path(__file__).resolve().parent.parent / "fipt_blender"
TOLD_AT = 0.1  # share of a job that is done when the time that it says is taken down
COLUMNS = (
    "capture",
    "pooled",
    "EAG-PT's way",
    "projection",
    "its way",
    "lamps, p",
    "said",
    "taken",
)


@dataclass(frozen=True)
class Job:
    """How a command went: seconds that it said in all after a tenth of it, that it took, and its error."""

    said: float | None
    taken: float
    error: dict[str, Any] | None


def run_product(arguments: Sequence[str]) -> Job:
    """Run a command of the product's own command line."""
    said, error, started = None, None, time.monotonic()
    command = [sys.executable, str(PRODUCT), *arguments, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            message = parse_message(line)
            if message is None:
                continue
            if message["type"] == "error":
                error = message
            if message["type"] == "progress" and said is None and message["fraction"] >= TOLD_AT:
                left = message.get("remaining_seconds")
                said = None if left is None else time.monotonic() - started + left
    return Job(said, time.monotonic() - started, error)


def estimated(folder: Path, output: Path, preset: str) -> tuple[RunFolder, Job]:
    """The run of a capture, prepared where it has no cameras."""
    run = output / folder.resolve().name
    options = ["--preset", preset, "--no-renders"]
    job = run_product(["estimate", str(folder), "--output", str(run), *options])
    if job.error and job.error["code"] == "mesh-missing":
        options.append("--mesh-from-photographs")
        job = run_product(["estimate", str(folder), "--output", str(run), *options])
    if job.error and job.error["code"] == "cameras-missing":
        prepared = output / f"{folder.resolve().name}-capture"
        first = run_product(["prepare", str(folder), str(prepared)])
        job = first
        if first.error is None:
            job = run_product(["estimate", str(prepared), "--output", str(run), *options])
    return RunFolder(run), job


def row(name: str, run: RunFolder, job: Job | None) -> list[str]:
    """One row of the table."""
    times = ["-", "-"]
    if job is not None:
        times = ["-" if job.said is None else f"{job.said:.0f} s", f"{job.taken:.0f} s"]
        if job.error is not None:
            return [f"{name}: {job.error['code']}: {job.error['text']}", *["-"] * 5, *times]
    quality = read_document(run.quality_json, QualityFigures)
    errors = np.array([view.errors for view in quality.views])  # (views, 2, channels)
    eag = (-10.0 * np.log10(np.maximum(errors, 1e-10))).mean(axis=(0, 2))
    lamps = [f"{lamp.probability:.2f}" for lamp in read_document(run.emitters_json, Emitters).fixtures]
    pooled = [f"{value:.2f}" for value in (quality.held_back_db, quality.projection_db)]
    shown = [pooled[0], f"{eag[0]:.2f}", pooled[1], f"{eag[1]:.2f}", " ".join(lamps) or "none"]
    return [name, *shown, *times]


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "folders", nargs="*", type=Path, metavar="FOLDER", help="captures as they were fetched"
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for their runs")
    parser.add_argument("--preset", default="draft", help="draft, medium or high (default: draft)")
    parser.add_argument("--run", action="append", default=[], type=Path, help="a finished run instead")
    arguments = parser.parse_args(list(argv))
    if arguments.folders and arguments.output is None:
        parser.error("--output is missing")
    jobs = [(each.name, *estimated(each, arguments.output, arguments.preset)) for each in arguments.folders]
    jobs += [(each.name, RunFolder(each), None) for each in arguments.run]
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for name, run, job in jobs:
        print(f"| {' | '.join(row(name, run, job))} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
