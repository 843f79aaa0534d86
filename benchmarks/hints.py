# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/hints.py RUN: answer the questions of a finished run truly, and score what that brings.

The run is of a capture with ground truth (benchmarks/truth.py) and has kept its stage folder. The estimate
with the answers replaces its results.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import metrics, truth
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.arrays import read_arrays
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.hints import DIELECTRIC, METAL, Hint, write_hints
from fipt_blender.core.run.result_contents import Doubt, Doubts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.shapes import PARTS_ARRAYS

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = ("kd_psnr", "a_prime_psnr", "sigma_psnr", "metallic_psnr")
GLOSSY = 0.5  # true roughness below which a surface is called glossy


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("run", type=Path, metavar="RUN", help="finished run with its stages")
    add("--count", type=int, default=5, help="questions that are answered (default: 5)")
    add(
        "--answers",
        choices=("words", "values"),
        default="values",
        help="metal or not, glossy or matt; or metal or not, and the true roughness (default)",
    )
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, or 1 where the re-estimate fails."""
    arguments = make_parser().parse_args(list(argv))
    run = RunFolder(arguments.run)
    set_variant(run.read().device)
    run.hints_again_json.unlink(missing_ok=True)
    seconds = {"without": estimate(run)}
    before = scores(run)
    hints = true_answers(run, arguments.count, arguments.answers)
    write_hints(run.hints_again_json, hints)
    seconds["hints"] = estimate(run)
    after = scores(run)
    for hint in hints:
        print(f"{hint.name:40s} {hint.material:10s} roughness {hint.roughness} lamp {hint.emits}")
    for split, figures in before.items():
        for name in COLUMNS:
            one, other = figures[name], after[split][name]
            print(f"{split:10s} {name:14s} {one:6.2f} {other:6.2f} {other - one:+6.2f} dB")
    print(f"{seconds['hints']:.0f} s; results alone {seconds['without']:.0f} s")
    if arguments.json:
        answers = [{**vars(hint), "points": list(hint.points)} for hint in hints]
        write_json(
            arguments.json.absolute(),
            {"before": before, "after": after, "seconds": seconds, "answers": answers},
        )
    return 0


def estimate(run: RunFolder) -> float:
    """Let the engine do what is left to do; returns the seconds.

    Raises:
        FiptError: ``run-failed``.
    """
    started = time.monotonic()
    command = [sys.executable, "-m", "fipt_blender.core", "estimate", str(run.root)]
    with run.log.open("ab") as log:
        ended = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True, check=False)
    for line in ended.stdout.splitlines():
        message = json.loads(line)
        if message["type"] in ("stage", "warning"):
            print(message["text"], file=sys.stderr)
    if ended.returncode:
        raise FiptError("run-failed", "The estimation failed.", f"Mend what {run.log} reports.")
    return time.monotonic() - started


def scores(run: RunFolder) -> dict[str, dict[str, float | None]]:
    """The figures of the maps of both splits, by the strict protocol."""
    from benchmarks import predict

    capture = load_capture(run)
    lit, _ = predict.load_result(run)
    result = {}
    for split, views in (("training", capture.train[::4]), ("held_back", capture.held_back)):
        true = [truth.read_maps(view) for view in views]
        filtered = truth.maps_are_filtered(true)
        predicted = [predict.predict_maps(lit, view, filtered) for view in views]
        result[split] = metrics.map_metrics(predicted, true, strict=True)
    return result


def true_answers(run: RunFolder, count: int, answers: str) -> list[Hint]:
    """The run's first questions with their true answers."""
    from fipt_blender.core.estimate.input import estimation_views
    from fipt_blender.core.textures.detail import solved_light

    doubts = read_document(run.doubts_json, Doubts).doubts[:count]
    views = estimation_views(run, run.read())
    pixels = solved_light(run, views).pixels
    part = read_arrays(run.parts_npz, PARTS_ARRAYS)["triangle_part"]
    names = [view.name for view in views]
    return [answer(doubt, views, names.index(doubt.view), pixels, part, answers) for doubt in doubts]


def answer(
    doubt: Doubt, views: Sequence[View], index: int, pixels: Any, part: np.ndarray, answers: str
) -> Hint:
    """The true answer to one question, from the true maps of the view that shows the part best.

    Args:
        index: of that view.
        pixels: of all views. part: (T,) unit of each triangle.
        answers: see the command's option.
    """
    rows = pixels.rows(index)
    triangle = np.asarray(pixels.triangle[rows])
    place = np.square(np.asarray(pixels.position[rows]) - doubt.point).sum(axis=1).argmin()
    on_part = (triangle >= 0) & (part[triangle] == part[triangle[place]])
    maps = truth.read_maps(views[index])
    roughness = float(np.median(maps.roughness.reshape(-1)[on_part]))
    metallic = float(np.median(maps.metallic.reshape(-1)[on_part]))
    emits = bool(np.median(maps.emission.reshape(-1, 3)[on_part].max(axis=1)) > 0.0)
    bounds = (roughness, roughness)
    if answers == "words":
        bounds = (0.0, GLOSSY) if roughness < GLOSSY else (GLOSSY, 1.0)
    point = tuple(doubt.point)
    material = METAL if metallic > 0.5 else DIELECTRIC
    return Hint((point,), f"{doubt.name}: {doubt.text}", False, material, bounds, emits)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
