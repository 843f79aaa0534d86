# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 benchmarks/scaling.py CAPTURE OUTPUT: how the cost of the engine's stages grows with a capture.

Three curves: over the number of views, of pixels per view and of triangles, while the other two stay small.
The captures are resampled from the given one (benchmarks/resampled.py), with few samples and steps, because
only the costs count. Writes scaling.json and a picture to OUTPUT; exponents are fitted to seconds and to
processor seconds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.curves import draw_curves, fit_exponent, write_pictures
from benchmarks.prepared import clear, copy_input, prepare
from benchmarks.resampled import write_room, write_views
from benchmarks.speed import machine
from benchmarks.turns import merged, take_turns, tell
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import Settings, make_settings

KINDS = ("pixels", "shadings", "estimate", "refinement", "training", "other")
# Less work than with the draft preset; no view may be left out, since that would change the size.
FEW_SAMPLES: dict[str, Any] = {
    "rounds": 1,
    "diffuse_spp": 8,
    "specular_spp": 4,
    "light_spp": 4,
    "refine_diffuse_spp": 8,
    "refine_specular_spp": 4,
    "refine_light_spp": 4,
    "training_steps": 30,
    "reject_views": False,
    "correct_exposure": False,
}
# The curve over triangles ends with stage 1, since training depends only on pixels.
LAST_STAGES = {"triangles": "shadings"}
UNITS = {"views": "views", "resolution": "pixels per view", "triangles": "triangles"}


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="scaling.py", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture whose views and mesh are resampled")
    add("output", type=Path, metavar="OUTPUT", help="folder for the figures and the runs")
    add("--views", default="10,20,40", metavar="N,N", help="sizes of the first curve (default: 10,20,40)")
    add(
        "--heights",
        default="80,160,320",
        metavar="N,N",
        help="heights of the second curve in pixels (default: 80,160,320)",
    )
    add(
        "--triangles",
        default="1e4,1e5,1e6",
        metavar="N,N",
        help="sizes of the third curve (default: 1e4,1e5,1e6)",
    )
    add("--base-views", type=int, default=10, help="views of the second and third curve (default: 10)")
    add("--base-height", type=int, default=80, help="height in the first and third curve (default: 80)")
    add(
        "--picture",
        type=Path,
        metavar="PNG",
        help="file for the picture of the curves (default: OUTPUT/scaling.png)",
    )
    add(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="runs of each size, of which the fastest counts (default: 1)",
    )
    add("--parts", default="auto", help="source of the parts (as for estimate)")
    add(
        "--preset",
        default="draft",
        help="draft, medium or high, but with fewer samples and steps (default: draft)",
    )
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of the runs")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; returns 0, or 1 after an error."""
    arguments = make_parser().parse_args(list(argv))
    try:
        sizes = {
            "views": read_sizes(arguments.views),
            "resolution": read_sizes(arguments.heights),
            "triangles": read_sizes(arguments.triangles),
        }
        changes = dict(change.partition("=")[::2] for change in arguments.set)
        settings = make_settings(arguments.preset, {**FEW_SAMPLES, **changes})
        set_variant(settings.device)
        source = prepare(arguments.capture, arguments.output / "input", ["--parts", arguments.parts])
        base = (arguments.base_views, arguments.base_height)
        head = {"machine": machine(), "settings": {key: str(value) for key, value in vars(arguments).items()}}
        curves: dict[str, Any] = {}
        for curves in measure(source, arguments.output, settings, sizes, base, arguments.repeats):
            # Written after each size, as a later one may be too large for the machine.
            write_json(arguments.output.absolute() / "scaling.json", {"curves": curves, **head})
            draw(curves, (arguments.picture or arguments.output / "scaling.png").absolute())
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    print(format_table(curves))
    return 0


def read_sizes(text: str) -> list[int]:
    """Whole numbers, ascending, from a text such as "1e4,100000"; none from an empty text.

    Raises:
        FiptError: ``option-invalid``.
    """
    try:
        sizes = sorted({int(float(word)) for word in text.split(",") if word.strip()})
    except (ValueError, OverflowError):
        sizes = [0]
    if any(size < 1 for size in sizes):
        raise FiptError(
            "option-invalid", f"'{text}' is not a list of sizes.", "Give numbers such as 10,20,40."
        )
    return sizes


def measure(
    source: RunFolder,
    folder: Path,
    settings: Settings,
    sizes: Mapping[str, Sequence[int]],
    base: tuple[int, int],
    repeats: int,
) -> Iterator[dict[str, Any]]:
    """Measure the curves; after each size, yields all that has been measured so far.

    {name: {"unit", "sizes": [...], "records": [`turns.merged` for each size], "stages": `fitted`}}.

    Args:
        source: input with the photographs.
        folder: for the run.
        settings: of all runs.
        sizes: by curve: numbers of views, heights in pixels, numbers of triangles.
        base: number of views and height in curves where they do not vary.
        repeats: runs of each size.
    """
    views, height = base

    def more_views(run: RunFolder, size: int) -> int:
        write_views(source, run, size, height)
        return size

    def more_pixels(run: RunFolder, size: int) -> int:
        return write_views(source, run, views, size)

    def more_triangles(run: RunFolder, size: int) -> int:
        write_views(source, run, views, height)
        return write_room(source, run, size)

    inputs: dict[str, Callable[[RunFolder, int], int]] = {
        "views": more_views,
        "resolution": more_pixels,
        "triangles": more_triangles,
    }
    curves: dict[str, Any] = {}
    warm = False
    for name, requested in sizes.items():
        actual: list[int] = []
        records: list[dict[str, Any]] = []
        for size in requested:
            runs = []
            for _ in range(repeats if warm else repeats + 1):
                run = RunFolder(folder / "run")
                clear(run)
                copy_input(source, run, settings)
                number = inputs[name](run, size)
                tell(f"{name}: {number}")
                runs.append(take_turns({"shipped": run}, LAST_STAGES.get(name))["shipped"])
            # The first run of all compiles kernels, which all others find in the cache.
            records.append(merged(runs[-repeats:]))
            actual.append(number)
            warm = True
            stages = fitted(actual, records)
            curves[name] = {"unit": UNITS[name], "sizes": actual, "records": records, "stages": stages}
            yield curves


def fitted(sizes: Sequence[int], records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Values at each size and their exponents, by kind of stage (all rounds together) and in total."""
    result: dict[str, Any] = {}
    for kind in (*KINDS, "all"):
        entry: dict[str, Any] = {}
        for key in ("seconds", "cpu_seconds"):
            values = [_sum(record, kind, key) for record in records]
            entry[key] = [round(value, 3) for value in values]
            prefix = key.removesuffix("seconds")
            entry[f"{prefix}exponent"] = fit_exponent(sizes, values)
            entry[f"{prefix}last_exponent"] = fit_exponent(sizes[-2:], values[-2:])
        entry["own_gb"] = [_most(record, kind) for record in records]
        result[kind] = entry
    # Anonymous memory, and resident memory with the pages of mapped files.
    for name, key in (("memory", "peak_own_gb"), ("resident", "peak_memory_gb")):
        memory = [record[key] for record in records]
        result[name] = {"gb": memory, "exponent": fit_exponent(sizes, memory)}
    return result


def _of_kind(record: Mapping[str, Any], kind: str) -> list[Mapping[str, Any]]:
    return [stage for stage in record["stages"] if stage["name"].partition("-")[0] == kind]


def _sum(record: Mapping[str, Any], kind: str, key: str) -> float:
    if kind == "all":
        return float(record[key])
    return float(sum(stage[key] for stage in _of_kind(record, kind)))


def _most(record: Mapping[str, Any], kind: str) -> float:
    """Peak anonymous memory in GB of the stages of a kind; 0 if it was not measured."""
    stages = record["stages"] if kind == "all" else _of_kind(record, kind)
    return max((float(stage.get("peak_own_gb", 0.0)) for stage in stages), default=0.0)


def draw(curves: Mapping[str, Any], path: Path) -> None:
    """Draw one row per curve: seconds and memory."""
    rows = []
    for curve in curves.values():
        row = []
        for title, key in (("Seconds", "seconds"), ("Own memory in GB", "own_gb")):
            lines = {kind: curve["stages"][kind][key] for kind in (*KINDS, "all")}
            row.append(draw_curves(f"{title} by stage over {curve['unit']}", curve["sizes"], lines))
        rows.append(row)
    write_pictures(rows, path)


def format_table(curves: Mapping[str, Any]) -> str:
    """Table of seconds by stage and size, with the exponents of all points and of the last two."""
    lines = []
    for curve in curves.values():
        head = "".join(f"{size:>12d}" for size in curve["sizes"])
        lines.append(f"{curve['unit']:14s}{head}{'exponent':>12s}{'last two':>10s}{'processor':>11s}")
        for kind in (*KINDS, "all"):
            entry = curve["stages"][kind]
            cells = "".join(f"{value:12.2f}" for value in entry["seconds"])
            exponents = [entry[key] for key in ("exponent", "last_exponent", "cpu_exponent")]
            shown = ["-" if value is None else f"{value:.2f}" for value in exponents]
            lines.append(f"{kind + ', s':14s}{cells}{shown[0]:>12s}{shown[1]:>10s}{shown[2]:>11s}")
        for name in ("memory", "resident"):
            memory = curve["stages"][name]
            exponent = "-" if memory["exponent"] is None else f"{memory['exponent']:.2f}"
            cells = "".join(f"{value:12.2f}" for value in memory["gb"])
            lines.append(f"{name + ', GB':14s}{cells}{exponent:>12s}")
        lines.append("")
    return "\n".join(lines).rstrip()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
