"""python3 dev.py scoreboard [ROW ...]: whole jobs, from the input folder to the .blend, and what they give.

Each row is a capture that goes through the product's own command line with its default options, but the draft
preset and without the batch's own renders. Then held-back photographs are compared with Cycles renders of the
.blend, and maps and lamps with the truth where it is known. Figures of a clean tree are stored in
docs/measurements/scoreboard/COMMIT.json, and printed with their differences from the last commit that was
measured; those that are worse by more than another seed makes them are red.

in Cycles     PSNR in dB of held-back photographs, in their own display values after one factor of exposure,
              against Cycles renders of the .blend; "on the mesh": over pixels whose ray hits it ("hit")
displayed     the same with what Blender displays after *Look Through*, without a factor
judged        the same, as the product judges itself; "projection": the training photographs on the mesh
gap           by which Cycles is below the projection, on the mesh
kd to relit   as of `dev.py accuracy`, by the paper's protocol
lamps         true, false and missed fixtures of a probability of 0.5, and of 0.95; lamps that were inferred
announced     seconds that the job first said that it would take
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy, ldr, prepared, results
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.result_contents import Emitters
from fipt_blender.core.run.runfolder import RunFolder

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE, ROOM = ROOT / "fipt_blender" / "example", ROOT / "examples" / "room"
STORED = results.MEASUREMENTS / "scoreboard"
# Figures, their formats, and which way is better: 1 more, -1 less, 0 neither.
FIGURES: dict[str, tuple[str, str, int]] = {
    "kd_psnr": ("kd", ".1f", 1),
    "a_prime_psnr": ("a′", ".1f", 1),
    "sigma_psnr": ("σ", ".1f", 1),
    "metallic_psnr": ("metallic", ".1f", 1),
    "relight_psnr": ("relit", ".1f", 1),
    "cycles_db": ("in Cycles", ".1f", 1),
    "cycles_on_mesh_db": ("on the mesh", ".1f", 1),
    "displayed_db": ("displayed", ".1f", 1),
    "judged_db": ("judged", ".1f", 0),
    "projection_db": ("projection", ".1f", 0),
    "gap_db": ("gap", ".1f", -1),
    "on_mesh_share": ("hit", ".2f", 1),
    "true_50": ("true, p ≥ .5", ".0f", 1),
    "false_50": ("false", ".0f", -1),
    "missed_50": ("missed", ".0f", -1),
    "true_95": ("true, p ≥ .95", ".0f", 1),
    "false_95": ("false", ".0f", -1),
    "missed_95": ("missed", ".0f", -1),
    "inferred": ("inferred", ".0f", 0),
    "seconds": ("seconds", ".0f", 0),
    "announced": ("announced", ".0f", 0),
    "peak_memory_gb": ("GB", ".1f", 0),
}
# What another seed changes, where no commit was measured with two.
SCATTER = {
    "kd_psnr": 0.5,
    "a_prime_psnr": 0.5,
    "sigma_psnr": 1.0,
    "metallic_psnr": 1.0,
    "on_mesh_share": 0.005,
}
OTHER_SCATTER = 0.3
RED, PLAIN = "\x1b[31m", "\x1b[0m"


@dataclass(frozen=True)
class Places:
    """Where inputs are: those that rows make themselves, rooms with ground truth, and fetched real rooms."""

    made: Path
    scenes: Path
    rooms: Path
    more: Path


@dataclass(frozen=True)
class Row:
    """A whole job.

    Attributes:
        label: for tables.
        capture: the folder, which need not exist, made where the row makes its own.
        options: of `estimate`, for a folder.
        truth: the capture with the truth of its held-back views and lamps; None: unknown.
        source: the folder that the capture is made of, if it is made.
    """

    label: str
    capture: Callable[[Places], Path]
    options: Callable[[Places], Sequence[str]] = lambda places: ()
    truth: Callable[[Places], Path | None] = lambda places: None
    source: Callable[[Places], Path] | None = None


def _jpeg(room: Callable[[Places], Path], places: Places) -> Path:
    """A room photographed as JPEG."""
    made = places.made / f"{room(places).name}-jpeg"
    if not made.exists():
        ldr.make_capture(room(places), made, seed=1)
    return made


def _scan(room: Callable[[Places], Path], places: Places) -> list[str]:
    """The options that use a scan of 2 cm of a room, without masks."""
    mesh = places.made / f"{room(places).name}-scan.ply"
    if not mesh.exists():
        accuracy.scan_capture(room(places), mesh, ["--voxel", "0.02"])
    return ["--mesh", str(mesh), *NO_MASKS]


def _without_lamps(room: Callable[[Places], Path], places: Places) -> Path:
    """A room of which no photograph shows a lamp."""
    made = places.made / f"{room(places).name}-no-lamp"
    if not made.exists():
        script = str(ROOT / "benchmarks" / "missing_light.py")
        command = [sys.executable, script, str(room(places)), "--output", str(made), "--missing", "behind"]
        subprocess.run(command, check=True)
    return made


def _states(name: str, label: str, room: Callable[[Places], Path]) -> dict[str, Row]:
    """The rows of a room with ground truth."""
    dark = partial(_without_lamps, room)
    jpeg, scan = partial(_jpeg, room), partial(_scan, room)
    return {
        name: Row(label, room, truth=room),
        f"{name}-no-masks": Row(f"{label}, no masks", room, lambda places: NO_MASKS, room),
        f"{name}-no-lamp": Row(
            f"{label}, no lamp in view, no masks", dark, lambda places: NO_MASKS, dark, room
        ),
        f"{name}-scan": Row(f"{label}, 2 cm scan, JPEG, no masks", jpeg, scan, room, room),
    }


def _bedsit_mesh(places: Places) -> list[str]:
    return ["--mesh", str(places.rooms / "bedsit-mesh.ply")]


NO_MASKS = ("--parts", "none")
ROWS = {
    "example": Row("shipped example", lambda places: EXAMPLE, truth=lambda places: ROOM),
    **_states("room", "example room", lambda places: ROOM),
    **_states("living-room", "living room", lambda places: places.scenes / "livingroom"),
    **_states("classroom", "classroom", lambda places: places.more / "classroom"),
    **_states("classroom-ground", "classroom on terrain", lambda places: places.more / "classroom-ground"),
    **_states("dining", "dining room", lambda places: places.more / "dining"),
    **_states("livingroom2", "second living room", lambda places: places.more / "livingroom2"),
    "office": Row("office kitchen (real)", lambda places: places.rooms / "office"),
    "lounge": Row("lounge (real)", lambda places: places.rooms / "lounge"),
    "bedsit": Row("bedsit (real)", lambda places: places.rooms / "bedsit", _bedsit_mesh),
}


def estimate_only(
    capture: Path, folder: Path, options: Sequence[str], truth: Path | None
) -> dict[str, float]:
    """Figures of an estimation without textures and Cycles; options as of `estimate`.

    Raises:
        FiptError: ``run-failed``.
    """
    run = prepared.prepare(capture, folder, options)
    script = ROOT / "benchmarks" / "trial_run.py"
    command = [sys.executable, str(script), str(run.root), *([] if truth is None else [str(truth)])]
    if subprocess.run(command, check=False).returncode:
        raise FiptError.of("run-failed", f"{capture} could not be estimated.", "See the error above.")
    found = json.loads((run.root / "trial.json").read_text(encoding="utf-8"))
    lamps, fixtures = found.get("lamps"), read_document(run.emitters_json, Emitters)
    figures = {**found.get("figures", {}).get("held_back", {}), "seconds": sum(found["seconds"].values())}
    figures |= {"inferred": sum(lamp.inferred for lamp in fixtures.missing)}
    if lamps is not None:
        figures |= {"true_50": lamps["true"], "false_50": lamps["false"], "missed_50": lamps["lost"]}
    if run.quality_json.exists():
        quality = read_document(run.quality_json, dict)
        figures |= {"judged_db": quality["held_back_db"], "projection_db": quality["projection_db"]}
    return {name: value for name, value in figures.items() if name in FIGURES and value is not None}


def measure(
    name: str, places: Places, folder: Path, seed: int, preset: str, reuse: bool, quick: bool = False
) -> dict[str, float]:
    """Figures of one row's whole job.

    Args:
        folder: of the run.
        reuse: score a finished run that is there.
        quick: only estimate, without textures and Cycles.

    Raises:
        FiptError: ``run-failed``.
    """
    row, figures = ROWS[name], {}
    capture = row.capture(places)
    if quick:
        options = ["--preset", preset, "--seed", str(seed), *row.options(places)]
        return estimate_only(capture, folder, options, row.truth(places))
    if reuse and (folder / "room.blend").exists():
        costs = accuracy.recorded_costs(RunFolder(folder))
        figures = {name: costs[name] for name in ("seconds", "peak_memory_gb")}
    else:
        options = ["--seed", str(seed), *row.options(places)]
        figures = accuracy.run_main_job(capture, folder, preset, options)
    scored = folder / "scoreboard.json"
    script = Path(__file__).resolve().with_name("score_run.py")
    command = [sys.executable, str(script), str(folder), str(scored)]
    truth = row.truth(places)
    if truth is not None:
        command += ["--truth", str(truth)]
    if subprocess.run(command, check=False).returncode:
        raise FiptError.of(
            "run-failed", f"The row {name} could not be scored.", "Mend what is reported above."
        )
    found = json.loads(scored.read_text(encoding="utf-8"))
    return {key: value for key, value in {**found, **figures}.items() if value is not None}


def scatter(history: Sequence[Mapping[str, Any]], label: str, figure: str) -> float:
    """The largest difference that another seed has made in stored measurements of a row, or `SCATTER`."""
    found = []
    for table in history:
        values = [
            row["figures"][figure]
            for row in table["rows"]
            if row["label"] == label and figure in row["figures"]
        ]
        if len(values) > 1:
            found.append(max(values) - min(values))
    return max(found, default=SCATTER.get(figure, OTHER_SCATTER))


def mean_figures(table: Mapping[str, Any], label: str) -> dict[str, float]:
    """Figures of a row in a stored table, the means over its seeds."""
    rows = [row["figures"] for row in table["rows"] if row["label"] == label]
    names = {name for figures in rows for name in figures if name in FIGURES}
    return {name: float(np.mean([each[name] for each in rows if name in each])) for name in names}


def changes(
    history: Sequence[Mapping[str, Any]], label: str, figures: Mapping[str, float]
) -> dict[str, tuple[float, bool]]:
    """Difference of each figure from the last stored measurement of a row, and whether it is a loss.

    Args:
        history: stored tables, the oldest first.
    """
    before = next((known for table in reversed(history) if (known := mean_figures(table, label))), {})
    result = {}
    for name, value in figures.items():
        if name in before and name in FIGURES:
            change, better = value - before[name], FIGURES[name][2]
            result[name] = change, better * change < -scatter(history, label, name)
    return result


def history(folder: Path = STORED) -> list[dict[str, Any]]:
    """Stored tables, the oldest first."""
    return sorted(
        (results.read_table(path) for path in folder.glob("*.json")), key=lambda table: table["date"]
    )


def print_row(label: str, figures: Mapping[str, float], told: Mapping[str, tuple[float, bool]]) -> None:
    """A row's figures with their differences from the last ones, losses in red."""
    print(f"{label}:")
    for name, (title, form, _) in FIGURES.items():
        if name not in figures:
            continue
        change = f" ({told[name][0]:+{form}})" if name in told else ""
        color, plain = (RED, PLAIN) if name in told and told[name][1] else ("", "")
        print(f"  {color}{title} {figures[name]:{form}}{change}{plain}", end=";")
    print(flush=True)


def print_worst(told: Mapping[str, Mapping[str, tuple[float, bool]]]) -> None:
    """The row in which each figure has lost most, or gained least, since the last measurement."""
    for name, (title, form, better) in FIGURES.items():
        rows = [(better * row[name][0], label) for label, row in told.items() if better and name in row]
        if rows:
            loss, label = min(rows)
            print(f"worst row, {title}: {better * loss:+{form}} ({label})", flush=True)


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(
        prog="dev.py scoreboard",
        description=(__doc__ or "").partition("\n")[0],
        epilog="rows: " + "; ".join(f"{name}: {row.label}" for name, row in ROWS.items()),
    )
    add = parser.add_argument
    shared = ROOT.parent / "shared"
    add("rows", nargs="*", metavar="ROW", help="names of rows (default: all whose input is there)")
    add("--preset", default="draft", help="draft, medium or high (default: draft)")
    add(
        "--seeds",
        type=int,
        nargs="+",
        default=[0],
        metavar="N",
        help="measure each row with these seeds (default: 0)",
    )
    add(
        "--output",
        type=Path,
        default=ROOT / "out" / "scoreboard",
        metavar="DIR",
        help="folder for inputs and runs",
    )
    add("--quick", action="store_true", help="only estimate, without textures and Cycles; not stored")
    add("--reuse", action="store_true", help="score finished runs in that folder instead of making them")
    add(
        "--scenes",
        type=Path,
        default=shared / "scenes",
        metavar="DIR",
        help="has livingroom/, with ground truth",
    )
    add(
        "--rooms",
        type=Path,
        default=shared / "real-rooms",
        metavar="DIR",
        help="has office/, lounge/, bedsit/ and bedsit-mesh.ply",
    )
    add(
        "--more-rooms",
        type=Path,
        default=shared / "rooms",
        metavar="DIR",
        help="has classroom/, classroom-ground/, dining/, livingroom2/, with ground truth",
    )
    add("--bounds", type=Path, metavar="FILE", help="fail where a figure leaves the bounds in this file")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; 1 for a failed job or a figure out of bounds."""
    arguments = make_parser().parse_args(list(argv))
    if unknown := set(arguments.rows) - set(ROWS):
        print(f"error: no rows: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    output = arguments.output.absolute()
    given = (arguments.scenes, arguments.rooms, arguments.more_rooms)
    places = Places(output / "inputs", *(path.absolute() for path in given))
    places.made.mkdir(parents=True, exist_ok=True)
    known, rows, failed = history(), [], False
    means: dict[str, dict[str, float]] = {}
    told: dict[str, dict[str, tuple[float, bool]]] = {}
    for name in arguments.rows or ROWS:
        label = ROWS[name].label
        if not (ROWS[name].source or ROWS[name].capture)(places).exists():
            print(f"{label}: left out, its input is not here", flush=True)
            continue
        for seed in arguments.seeds:
            try:
                folder = output / f"{name}-{seed}"
                figures = measure(
                    name, places, folder, seed, arguments.preset, arguments.reuse, arguments.quick
                )
            except FiptError as error:
                print(f"{RED}{label}: {error.text} {error.remedy}{PLAIN}", flush=True)
                failed = True
                continue
            rows.append({"label": label, "seed": seed, "figures": figures})
        means[name] = mean_figures({"rows": rows}, label)
        if not means[name]:
            continue
        told[label] = changes(known, label, means[name])
        print_row(label, means[name], told[label])
        if not arguments.quick:
            store(rows, known, arguments.preset)  # after each, as all take hours
    print_worst(told)
    broken = []
    if arguments.bounds:
        bounds = json.loads(arguments.bounds.read_text(encoding="utf-8"))
        broken = accuracy.out_of_bounds(means, bounds)
    for line in broken:
        print(f"{RED}out of bounds: {line}{PLAIN}", file=sys.stderr)
    return int(failed or bool(broken))


def store(rows: list[dict[str, Any]], known: Sequence[Mapping[str, Any]], preset: str) -> None:
    """Write the rows into the commit's file, in place of its older ones; nothing where files have changed."""
    device = "cuda" if os.environ.get("FIPT_TEST_DEVICE") == "cuda" else "llvm"
    common = results.provenance(
        "that of the row", 0, device, ["python3", "dev.py", "scoreboard", "--preset", preset]
    )
    if not common["commit"] or common["commit"].endswith("+"):
        print("not stored: the tree has changes that are not committed", flush=True)
        return
    path = STORED / f"{common['commit']}.json"
    stamp = ["git", "show", "-s", "--format=%cI", "HEAD"]
    date = subprocess.run(stamp, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    kept = results.read_table(path)["rows"] if path.exists() else []
    mine = {(row["label"], row["seed"]) for row in rows}
    kept = [row for row in kept if (row["label"], row["seed"]) not in mine]
    order = [row.label for row in ROWS.values()]
    every = sorted([*kept, *rows], key=lambda row: (order.index(row["label"]), row["seed"]))
    before = [table for table in known if table["common"]["commit"] != common["commit"]]
    every = [{name: row[name] for name in ("label", "seed", "figures")} for row in every]
    for row in every:
        row["figures"] = {name: round(value, 4) for name, value in row["figures"].items() if name in FIGURES}
        told = changes(before, row["label"], row["figures"])
        texts = {
            name: f" ({told[name][0]:+{FIGURES[name][1]}})" if name in told else "" for name in row["figures"]
        }
        row["figures"] |= {f"{name}_change": text for name, text in texts.items()}
    columns = [[title, f"{{{name}:{form}}}{{{name}_change}}"] for name, (title, form, _) in FIGURES.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    table = {"first": f"{preset} preset", "date": date, "columns": columns, "common": common, "rows": every}
    path.write_text(results.written(table), encoding="utf-8", newline="\n")
    print(path, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
