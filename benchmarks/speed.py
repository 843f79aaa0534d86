# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 dev.py speed CAPTURE: the engine as shipped against the paper's algorithm with its sample counts.

Both estimate the same capture on the same machine and take turns stage by stage (benchmarks/speed_engine.py,
benchmarks/reference.py). Prints time, rays, memory and the error of the shadings for each stage, and the
accuracy of both. On a machine that is busy with other work, compare processor seconds.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy, picture_page, shading_error, speed_table
from benchmarks.prepared import clear, copy_input, prepare
from benchmarks.speed_engine import kept_path
from benchmarks.turns import merged, take_turns, tell
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import PRODUCT_VERSION, RunFolder, write_json
from fipt_blender.core.run.settings import Settings, make_settings

ROOT = Path(__file__).resolve().parent.parent
CONFIGURATIONS = ("reference", "shipped")
AUTHORS_STEPS = 10_000
TIMES_NAME = "times.json"


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="dev.py speed", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture; with ground truth, errors are measured too")
    add("--json", type=Path, metavar="FILE", help="write all figures to a file")
    add("--output", type=Path, metavar="DIR", help="folder of both runs (default: in out/speed)")
    add("--preset", default="medium", help="of the shipped configuration (default: medium)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one of its settings")
    add("--parts", default="auto", help="source of the parts in both runs (as for estimate)")
    add("--views", type=float, default=1.0, metavar="SHARE", help="share of the training views (default: 1)")
    add("--device", default="auto", help="auto, cuda or llvm (default: auto)")
    add("--seed", type=int, default=0, help="seed of both runs (default: 0)")
    add(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="runs of both, of which the fastest count (default: 1)",
    )
    add(
        "--reference-steps",
        type=int,
        default=AUTHORS_STEPS,
        metavar="N",
        help=f"steps of each of its three trainings (default: the paper's, {AUTHORS_STEPS})",
    )
    add(
        "--reference-samples",
        type=float,
        default=1.0,
        metavar="SHARE",
        help="share of the authors' samples, for quick tests (default: 1)",
    )
    add(
        "--error-pixels",
        type=int,
        default=2000,
        metavar="N",
        help="pixels whose shadings are compared with path tracing (default: 2000)",
    )
    add("--spp", type=int, default=64, help="paths per pixel of the renders for accuracy (default: 64)")
    add("--train-views", type=int, default=4, help="training views whose maps are compared (default: 4)")
    add("--skip-accuracy", action="store_true", help="do not measure accuracy")
    add("--reuse", action="store_true", help="evaluate the existing runs of an earlier call in DIR")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; returns 0, or 1 after an error."""
    arguments = make_parser().parse_args(list(argv))
    folder = arguments.output or ROOT / "out" / "speed" / arguments.capture.absolute().name
    try:
        result = read_document(folder / TIMES_NAME, dict) if arguments.reuse else measure(arguments, folder)
        judge(result, arguments, folder)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    print(speed_table.format_result(result))
    if arguments.json:
        write_json(arguments.json.absolute(), result)
    return 0


def measure(arguments: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Run both configurations; times are saved with the runs before these are evaluated, which may fail.

    Raises:
        FiptError: see :func:`configurations`, `prepare` and :func:`compare`.
    """
    settings = configurations(arguments)
    tell("preparing the capture")
    source = prepare(arguments.capture, folder / "input", ["--parts", arguments.parts])
    result = compare(source, folder, settings, arguments.repeats)
    options = vars(arguments).items()
    result["settings"] = {name: str(value) if isinstance(value, Path) else value for name, value in options}
    write_json(folder / TIMES_NAME, result)
    tell(speed_table.format_stages(result))
    return result


def configurations(arguments: argparse.Namespace) -> dict[str, Settings]:
    """Settings of both configurations.

    Raises:
        FiptError: ``setting-unknown``, ``setting-invalid`` or ``option-invalid``.
    """
    if arguments.repeats < 1 or arguments.reference_steps < 1 or not arguments.reference_samples > 0.0:
        raise FiptError(
            "option-invalid", "Repeats, steps and samples must be above zero.", "Give at least 1."
        )
    common = {"device": arguments.device, "seed": arguments.seed, "view_share": arguments.views}
    # Set before the reference's module is imported, which needs the variant.
    set_variant(make_settings("draft", {"device": arguments.device}).device)
    from benchmarks.reference import reference_settings

    changes = dict(change.partition("=")[::2] for change in arguments.set)
    return {
        "reference": reference_settings(arguments.reference_steps, arguments.reference_samples, common),
        "shipped": make_settings(arguments.preset, {**common, **changes}),
    }


def compare(
    source: RunFolder, folder: Path, settings: Mapping[str, Settings], repeats: int = 1
) -> dict[str, Any]:
    """Run both configurations, which take turns.

    Args:
        source: run folder that is ready for an estimation.
        folder: gets a run folder for each configuration; those of an earlier comparison are removed.
        settings: of each configuration.

    Returns:
        {"ratio", "stage_ratios", "machine", and for each configuration its times and settings}.

    Raises:
        FiptError: ``run-failed`` if an estimation fails.
    """
    records: dict[str, list[dict[str, Any]]] = {name: [] for name in settings}
    for repeat in range(repeats):
        runs = {name: RunFolder(folder / name) for name in settings}
        for name, run in runs.items():
            clear(run)
            copy_input(source, run, settings[name])
        tell(f"repeat {repeat + 1} of {repeats}")
        for name, record in take_turns(runs).items():
            records[name].append(record)
    result: dict[str, Any] = {
        name: merged(repeats) | {"settings": asdict(settings[name])} for name, repeats in records.items()
    }
    return ratios(*(result[name] for name in CONFIGURATIONS)) | result | {"machine": machine()}


def ratios(reference: Mapping[str, Any], shipped: Mapping[str, Any]) -> dict[str, Any]:
    """Times of the reference divided by the engine's, in total and by kind of stage (all rounds together)."""

    def by_kind(record: Mapping[str, Any], key: str) -> dict[str, float]:
        sums: dict[str, float] = {}
        for stage in record["stages"]:
            # The reference trains in each round, where the engine has a closed form.
            kind = stage["name"].partition("-")[0].replace("estimate", "training")
            sums[kind] = sums.get(kind, 0.0) + stage[key]
        return sums

    result: dict[str, Any] = {}
    for prefix, key in (("", "seconds"), ("cpu_", "cpu_seconds")):
        result[f"{prefix}ratio"] = _ratio(reference[key], shipped[key])
        first, second = by_kind(reference, key), by_kind(shipped, key)
        result[f"{prefix}stage_ratios"] = {
            kind: _ratio(value, second[kind]) for kind, value in first.items() if kind in second
        }
    return result


def _ratio(first: float, second: float) -> float | None:
    return round(first / second, 3) if second > 0.0 else None


def judge(result: dict[str, Any], arguments: argparse.Namespace, folder: Path) -> None:
    """If there is ground truth, add the errors of the shadings and the accuracy of both configurations."""
    runs = {name: RunFolder(folder / name) for name in CONFIGURATIONS}
    set_variant(arguments.device)
    if arguments.error_pixels and shading_error.has_true_materials(arguments.capture):
        tell("tracing the shadings' truth")
        enter_errors(result, arguments.capture, runs, arguments.error_pixels)
    if arguments.skip_accuracy or not (arguments.capture / "val" / "DiffCol").is_dir():
        return
    scope = accuracy.Scope(arguments.capture, arguments.spp, arguments.train_views, train_renders=0)
    for name, run in runs.items():
        tell(f"scoring {name}")
        page = picture_page.PicturePage(run.root / "accuracy")
        result[name]["accuracy"] = accuracy.score(run, scope, page).figures
        page.write(result[name]["accuracy"])


def enter_errors(result: dict[str, Any], capture: Path, runs: Mapping[str, RunFolder], count: int) -> None:
    """Add the errors of the shadings after stage 1 and after each round of stage 3 to the stages' records."""
    baked: dict[str, Any] = {}
    rows = np.zeros(0, np.int64)
    for name, run in runs.items():
        for stage in result[name]["stages"]:
            path = kept_path(run, stage["name"])
            if path.exists():
                with np.load(path, allow_pickle=False) as data:
                    rows = data["rows"]
                    shadings = shading_error.Views(data["diffuse"], data["specular"])
                    baked[f"{name} {stage['name']}"] = (shadings, data["levels"])
    errors = shading_error.baked_errors(capture, runs["shipped"], rows, baked, count)
    result["shading_pixels"], result["shading_levels"] = errors["pixels"], errors["levels"]
    for name in runs:
        for stage in result[name]["stages"]:
            stage["shading_error"] = errors.get(f"{name} {stage['name']}")


def machine() -> dict[str, Any]:
    """Description of the machine and of the packages with which the figures were measured."""
    import mitsuba as mi

    memory = 0.0
    if hasattr(os, "sysconf"):
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    versions = {name: importlib.metadata.version(name) for name in ("mitsuba", "drjit", "torch")}
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "memory_gb": round(memory, 1),
        "variant": mi.variant(),
        "python": platform.python_version(),
        "product": PRODUCT_VERSION,
        **versions,
    }


def processor_name() -> str:
    """The name of the processor according to the system."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
