"""What each mechanism brings: estimates with one mechanism off, or one number halved or doubled, on a jury.

    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none,parts --off torn_parts,outlines
    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none --numbers views.torn_parts
    python benchmarks/trial.py WORK --table docs/measurements/mechanisms.json      # then: dev.py results
    python benchmarks/trial.py --list

Captures: see benchmarks/trial_captures.py; several words divided by commas stand for all of them. Numbers are
module constants (views.torn_parts.LEAST_VIEWS) and settings (settings.view_error).
WORK gets the captures, what runs begin with, and runs.jsonl, a line for each finished run; finished runs are
not repeated. A run begins with the stages of the capture's first run that do not depend on what differs.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import prepared, results
from benchmarks.trial_captures import Case, Jury, cases
from benchmarks.trial_changes import BASE, Change, changes_of, format_list
from benchmarks.trial_run import BAKED, COMPLETED
from benchmarks.trial_table import as_table
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.method import method_digest
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings

ROOT = Path(__file__).resolve().parent.parent


class Trial:
    """The runs of a jury, below its folder.

    Args:
        settings: changed ones of all runs. preset: of all runs.
    """

    def __init__(self, jury: Jury, settings: Mapping[str, Any], preset: str = "draft") -> None:
        self.jury, self.settings, self.preset = jury, dict(settings), preset
        self.lines = jury.work / "runs.jsonl"

    def finished(self) -> list[dict[str, Any]]:
        """The finished runs of the present method with these settings."""
        if not self.lines.exists():
            return []
        rows = [json.loads(line) for line in self.lines.read_text(encoding="utf-8").splitlines()]
        wanted = {"method": method_digest(), **self._made_with}
        return [row for row in rows if {name: row.get(name, self.preset) for name in wanted} == wanted]

    @property
    def _made_with(self) -> dict[str, Any]:
        return {"settings": self.settings, "seed": self.jury.seed, "preset": self.preset}

    def do(self, case: Case, change: Change) -> None:
        """Do one run, and add its line.

        Raises:
            FiptError: ``run-failed``, and those of making the capture.
        """
        jury = self.jury
        capture = jury.capture(case)
        source = jury.prepared(case, capture)
        store = jury.work / "stored" / f"{case.folder}-{jury.seed}-{self.preset}-{method_digest()[:8]}"
        run = RunFolder(jury.work / "run")
        prepared.clear(run)
        prepared.copy_input(source, run, make_settings(self.preset, {**self.settings, **change.settings}))
        options = ["--constants", json.dumps(dict(change.constants))]
        if change.name == BASE:
            options += ["--store", str(store)]
        elif change.begins:
            shutil.copytree(store / COMPLETED, run.scan, dirs_exist_ok=True)
            if change.begins == BAKED:
                shutil.copytree(store / BAKED, run.stage, dirs_exist_ok=True)
        command = [sys.executable, str(ROOT / "benchmarks" / "trial_run.py"), str(run.root), str(capture)]
        with run.log.open("a", encoding="utf-8") as log:
            ended = subprocess.run([*command, *options], stdout=log, stderr=log, check=False)
        row = {"capture": case.name, "change": change.name, "method": method_digest()}
        row |= self._made_with
        if ended.returncode:
            failed = jury.work / "failed"
            shutil.rmtree(failed, ignore_errors=True)
            shutil.copytree(run.root, failed)
            row |= {"error": run.log.read_text(encoding="utf-8").strip().splitlines()[-1:]}
        else:
            row |= json.loads((run.root / "trial.json").read_text(encoding="utf-8"))
        with self.lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def pending(self, chosen: Sequence[Case], changes: Sequence[Change]) -> Iterator[tuple[Case, Change]]:
        """The runs that are missing, the method as it is before the others of a capture."""
        for change in changes:
            for case in chosen:
                if not case.has(change.needs):
                    continue
                if (case.name, BASE) not in self._failed():
                    yield case, Change()
                # Where the method itself fails there is nothing to compare with.
                failed = self._failed()
                if not failed.get((case.name, BASE), True) and (case.name, change.name) not in failed:
                    yield case, change

    def _failed(self) -> dict[tuple[str, str], bool]:
        """Whether each finished run failed, by its capture and its change."""
        return {(row["capture"], row["change"]): "error" in row for row in self.finished()}


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("work", nargs="?", type=Path, metavar="WORK", help="folder of captures and finished runs")
    add("--list", action="store_true", help="list mechanisms and numbers")
    add("--room", action="append", default=[], metavar="NAME=DIR", help="a capture with ground truth")
    add("--captures", default="", metavar="ROOM:MESH:LIGHT:MASKS ...", help="the jury")
    add("--off", default="", metavar="NAME,NAME", help="mechanisms; seed1: another seed; all")
    add("--numbers", default="", metavar="PREFIX,PREFIX", help="constants that are halved and doubled")
    add("--preset", default="draft", help="draft, medium or high (default: draft)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of all runs")
    add("--seed", type=int, default=0, help="of scans, cameras and faults of masks")
    add("--most", type=int, metavar="N", help="do at most so many runs")
    add("--table", type=Path, metavar="FILE", help="write the table of the finished runs, for dev.py results")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, 1 after an error or a failed run, 2 for wrong usage."""
    arguments = make_parser().parse_args(list(argv))
    if arguments.list:
        print(format_list())
        return 0
    if arguments.work is None:
        print("error: name a folder, or use --list.", file=sys.stderr)
        return 2
    try:
        rooms = {name: Path(path) for name, _, path in (word.partition("=") for word in arguments.room)}
        settings = dict(word.partition("=")[::2] for word in arguments.set)
        trial = Trial(Jury(arguments.work, rooms, arguments.seed), settings, arguments.preset)
        chosen = cases(arguments.captures)
        changes = changes_of(arguments.off, arguments.numbers, arguments.preset)
        unknown = {case.room for case in chosen} - rooms.keys()
        if unknown:
            raise FiptError.of("trial-unknown", f"No --room names {', '.join(unknown)}.", "Name its folder.")
        for case, change in itertools.islice(trial.pending(chosen, changes or [Change()]), arguments.most):
            print(f"== {case.name} {change.name or 'as it is'}", file=sys.stderr, flush=True)
            trial.do(case, change)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    rows = trial.finished()
    captures = ", ".join(sorted({row["capture"] for row in rows}))
    command = ["benchmarks/trial.py", *argv]
    table = as_table(
        rows, results.provenance(captures, arguments.seed, str(settings.get("device", "auto")), command)
    )
    print(results.markdown(table))
    if arguments.table:
        arguments.table.write_text(results.written(table), encoding="utf-8", newline="\n")
    return 1 if any("error" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
