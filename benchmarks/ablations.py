# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 benchmarks/ablations.py CAPTURE OUTPUT: run the paper's ablations and print a table.

Each ablation is a run of benchmarks/accuracy.py with other options; finished runs (OUTPUT/NAME.json) are not
repeated. The table lists the figures of the paper's Tables 3 and 4 too, which are for its kitchen: compare
the differences from the full model, not the values. More than one seed of the full model gives the noise
floor.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy
from fipt_blender.core.run.documents import read_json

COLUMNS = ("kd_psnr", "a_prime_psnr", "sigma_psnr", "emission_iou", "emission_log_l2", "relight_psnr")
FULL = "full"


@dataclass(frozen=True)
class Ablation:
    """One row of the table.

    Attributes:
        text: the difference from the full model.
        options: of benchmarks/accuracy.py.
        paper: the paper's figures in the order of COLUMNS (Tables 3 and 4, kitchen), None if it has none.
    """

    text: str
    options: tuple[str, ...] = ()
    paper: tuple[float | None, ...] = (None,) * len(COLUMNS)


ABLATIONS: dict[str, Ablation] = {
    FULL: Ablation("full model, part masks", (), (33.07, 27.53, 29.24, 0.91, 1.54e-3, 29.13)),
    "joint-emission": Ablation(
        "joint L_e optimisation", ("--set", "emission=joint"), (32.31, 25.50, 22.77, 0.10, 6.62e-1, None)
    ),
    "no-stage-3": Ablation(
        "without stage 3", ("--set", "rounds=0"), (32.20, 25.18, 23.37, 0.91, 1.54e-3, None)
    ),
    "no-cache": Ablation(
        "stage 3 without radiance cache",
        ("--set", "refine_cache=false"),
        (19.35, 16.82, 25.65, 0.91, 1.54e-3, None),
    ),
    "fewer-views": Ablation(
        "30 % of the views", ("--set", "view_share=0.3"), (32.64, 26.7, 28.80, 0.91, 1.57e-3, 28.90)
    ),
    "disturbed-mesh": Ablation(
        "mesh disturbed by 1 cm (paper: MonoSDF's)",
        ("--mesh-noise", "0.01"),
        (27.01, 22.57, 21.33, 0.78, 0.1142, 27.90),
    ),
    "semantics": Ablation(
        "semantic masks", ("--parts", "semantics"), (33.25, 27.38, 21.70, 0.91, 1.54e-3, 28.79)
    ),
    "no-masks": Ablation("no masks", ("--parts", "none")),
    "cycles-g": Ablation("G as in Cycles, which renders it exactly", ("--set", "masking=smith")),
}


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="ablations.py", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture with ground truth")
    add("output", type=Path, metavar="OUTPUT", help="folder of the runs and their figures")
    add("--preset", default="medium", help="draft, medium or high (default: medium)")
    add("--only", default=",".join(ABLATIONS), metavar="A,B", help=f"of: {', '.join(ABLATIONS)}")
    add("--seeds", type=int, default=1, metavar="N", help="runs of the full model (default: 1)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of all runs")
    add(
        "--spp", type=int, default=64, help="paths per pixel of the renders, which are denoised (default: 64)"
    )
    add("--table", type=Path, metavar="FILE", help="also write the table to a file")
    return parser


def main(argv: Sequence[str]) -> int:
    """Do the runs that are missing and print the table; returns 0, 1 if a run failed, 2 for wrong usage."""
    parser = make_parser()
    arguments = parser.parse_args(list(argv))
    names = [name for name in arguments.only.split(",") if name]
    unknown = [name for name in names if name not in ABLATIONS]
    if unknown or arguments.seeds < 1:
        print(f"error: no such ablation: {', '.join(unknown) or arguments.seeds}", file=sys.stderr)
        return 2
    failed = False
    for name, options in planned(arguments, names):
        target = arguments.output / f"{name}.json"
        if target.exists():
            continue
        print(f"== {name}", file=sys.stderr, flush=True)
        run = arguments.output / name
        command = [str(arguments.capture), "--output", str(run), "--json", str(target), "--skip-cycles"]
        command += ["--preset", arguments.preset, "--spp", str(arguments.spp), "--resume"]
        command += ["--train-views", "4", "--train-renders", "1", *options]
        failed |= accuracy.main(command) != 0
    text = table(arguments.output)
    print(text)
    if arguments.table:
        arguments.table.write_text(text + "\n", encoding="utf-8")
    return 1 if failed else 0


def planned(arguments: argparse.Namespace, names: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Names of the runs and their options, including the other seeds of the full model."""
    common = [word for change in arguments.set for word in ("--set", change)]
    runs = []
    for name in names:
        options = [*common, *ABLATIONS[name].options]
        runs.append((name, options))
    if FULL in names:
        runs += [
            (f"{FULL}-seed-{seed}", [*common, "--set", f"seed={seed}"]) for seed in range(1, arguments.seeds)
        ]
    return runs


def table(folder: Path) -> str:
    """Table of the figures of all finished runs (held-back views) and of the paper's."""
    results = {path.stem: read_json(path)["held_back"] for path in sorted(folder.glob("*.json"))}
    head = f"{'held-back views, paper protocol':44s}" + "".join(
        f"{name.removesuffix('_psnr'):>16s}" for name in COLUMNS
    )
    lines = [head]
    for name, ablation in ABLATIONS.items():
        if name in results:
            lines.append(f"{ablation.text:44s}" + _cells([results[name].get(key) for key in COLUMNS]))
        if name in results and any(value is not None for value in ablation.paper):
            lines.append(f"{'  paper (kitchen)':44s}" + _cells(ablation.paper))
    full = [figures for name, figures in results.items() if name == FULL or name.startswith(f"{FULL}-seed-")]
    if len(full) > 1:
        lines.append(f"{f'noise floor: spread of {len(full)} seeds':44s}" + _cells(spread(full)))
    return "\n".join(lines)


def spread(results: Sequence[Mapping[str, Any]]) -> list[float | None]:
    """Range (highest minus lowest) of each figure; None if a run lacks it."""
    ranges: list[float | None] = []
    for key in COLUMNS:
        values = [figures.get(key) for figures in results]
        known = [value for value in values if value is not None]
        ranges.append(max(known) - min(known) if len(known) == len(values) else None)
    return ranges


def _cells(values: Sequence[float | None]) -> str:
    cells = []
    for key, value in zip(COLUMNS, values, strict=True):
        digits = ".2e" if key.endswith("log_l2") else ".3f" if key.endswith("iou") else ".2f"
        cells.append(f"{'-':>16s}" if value is None else f"{value:16{digits}}")
    return "".join(cells)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
