"""python3 dev.py speed CAPTURE: seconds and memory of the main job, by step and by stage of the estimation.

The job runs as a user runs it, several times, each time from the beginning; the table has medians, and those
of an earlier measurement beside them. On a machine that is busy with other work, compare processor seconds.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy, results
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json

ROOT = Path(__file__).resolve().parent.parent


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="dev.py speed", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="any capture; no ground truth is needed")
    add("--preset", default="medium", help="draft, medium or high (default: medium)")
    add("--option", action="append", default=[], metavar="OPTION", help="more options of estimate")
    add("--repeats", type=int, default=3, metavar="N", help="runs of which medians are told (default: 3)")
    add("--output", type=Path, metavar="RUN", help="run folder to make (default: below out/speed)")
    add("--before", type=Path, metavar="FILE", help="compare with what --json has written")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; returns 0, or 1 after an error."""
    arguments = make_parser().parse_args(list(argv))
    name = f"{arguments.capture.absolute().name}-{arguments.preset}"
    folder = arguments.output or ROOT / "out" / "speed" / name
    try:
        before = read_document(arguments.before, dict)["figures"] if arguments.before else {}
        runs = [measured(arguments, folder) for _ in range(max(1, arguments.repeats))]
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    found = medians(runs)
    print(format_table(found, before))
    if arguments.json:
        settings = RunFolder(folder).read()
        command = ["python3", "dev.py", "speed", *sys.argv[1:]]
        source = results.provenance(arguments.capture.name, settings.seed, settings.device, command)
        write_json(arguments.json.absolute(), {"measured": source, "figures": found, "runs": runs})
    return 0


def measured(arguments: argparse.Namespace, folder: Path) -> dict[str, float]:
    """Figures of one run of the main job: see :func:`figures_of`, and seconds of the processor.

    Raises:
        FiptError: ``run-failed``.
    """
    started = _processor_seconds()
    costs = accuracy.run_main_job(arguments.capture, folder, arguments.preset, arguments.option)
    spent = _processor_seconds() - started
    figures = figures_of({**accuracy.recorded_costs(RunFolder(folder)), **costs})
    return figures | {"processor": round(spent, 1)}


def _processor_seconds() -> float:
    """Of all child processes that have ended; 0 on Windows, which does not tell."""
    spent = os.times()
    return spent.children_user + spent.children_system


def figures_of(costs: Mapping[str, Any]) -> dict[str, float]:
    """Seconds by step and by stage, whole seconds, and GB of the engine at most, of a run's records."""
    found = {f"step {name}": value for name, value in costs.get("step_seconds", {}).items()}
    for stage in costs.get("statistics", {}).get("stages", []):
        found[f"stage {stage['name']}"] = stage["seconds"]
    return found | {"seconds": costs["seconds"], "memory (GB)": costs["peak_memory_gb"]}


def medians(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The median of each figure over those runs that have it, in the first run's order."""
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: statistics.median(run[name] for run in runs if name in run) for name in names}


def format_table(found: Mapping[str, float], before: Mapping[str, float]) -> str:
    """The figures as text, beside earlier ones where there are some."""
    lines = []
    for name in dict.fromkeys([*before, *found]):
        values = [before.get(name), found.get(name)] if before else [found.get(name)]
        cells = ["-" if value is None else f"{value:.1f}" for value in values]
        lines.append(f"{name:28s}" + "".join(f"{cell:>10s}" for cell in cells))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
