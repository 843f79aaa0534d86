# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each mechanism brings: estimates with one mechanism off, or one number halved or doubled, on a jury.

    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none,parts --off torn_parts,outlines
    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none --numbers views.torn_parts
    python benchmarks/trial.py WORK --table results.md
    python benchmarks/trial.py --list

A capture of the jury is a room (a capture with ground truth in the FIPT authors' synthetic layout), its mesh
(exact, or scanned with voxels of so many centimetres), its photographs (hdr, jpeg) and its masks (parts,
linked: masks of single photographs with faults, none); several words divided by commas stand for all of them.
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
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy, ldr, own_masks, prepared
from benchmarks.constants import CORE, Constant, all_constants
from benchmarks.trial_run import BAKED, CLEANED, CLEANED_FILES, COMPLETED, COMPLETED_FILES, copy_files
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.method import method_digest
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings, make_settings

ROOT = Path(__file__).resolve().parent.parent
SCAN, JPEG, MASKS, SHARED, OWN, NO_MASKS = "scan", "jpeg", "masks", "parts", "linked", "none"
FACTORS = (0.5, 2.0)
BASE = ""  # the method as it is
# Figures of the table, and the gain from which on one counts (dB; IoU; log L2 never decides).
COLUMNS = {
    "kd_psnr": 0.3, "a_prime_psnr": 0.3, "sigma_psnr": 0.3, "metallic_psnr": 0.3, "emission_iou": 0.02,
    "view_synthesis_psnr": 0.3, "relight_psnr": 0.3,
}  # fmt: skip
TITLES = ("kd", "a′", "σ", "metallic", "IoU", "re-rendered", "relit")
# Rooms whose numbers have an effect after the shadings alone, and those of which only the mesh's are before.
AFTER_SHADINGS, AFTER_MESH = ("material", "estimate"), ("light", "radiometry", "optics")


@dataclass(frozen=True)
class Mechanism:
    """Something that the paper does not have.

    Attributes:
        text: what it does.
        modules: files below core/ that only it needs.
        off: settings without it.
        needs: of a capture: SCAN, JPEG, MASKS (of any kind), or the kind of masks.
    """

    text: str
    modules: tuple[str, ...]
    off: Mapping[str, Any]
    needs: tuple[str, ...] = ()


MECHANISMS = {
    "clean_scan": Mechanism(
        "scans treated as scans: cleaned, with doubt", ("geometry/clean", "geometry/planes", "geometry/normals",
        "geometry/patches", "geometry/roughness"), {"clean_scan": False}, (SCAN,)
    ),
    "closing": Mechanism("small holes closed", ("geometry/closing",), {"close_holes_edges": 0}, (SCAN,)),
    "panes": Mechanism("panes in flat holes", ("geometry/holes",), {"panes": False}, (SCAN,)),
    "lost_parts": Mechanism(
        "prisms of lost parts", ("views/lost_parts", "geometry/prism"), {"lost_parts": False}, (SCAN, SHARED)
    ),
    "lost_surfaces": Mechanism(
        "lost surfaces without shared masks", ("views/lost_surfaces", "views/agreement"),
        {"lost_surfaces": False}, (SCAN,)
    ),
    "torn_parts": Mechanism(
        "torn parts completed", ("views/torn_parts", "geometry/revolution", "geometry/sheet"),
        {"torn_parts": False}, (SCAN, MASKS)
    ),
    "outlines": Mechanism(
        "outlines of parts", ("scene/outlines", "scene/outline_misses"), {"outlines": False}, (SCAN, MASKS)
    ),
    "doubt_pixels": Mechanism(
        "doubt where mask and scan disagree", ("scene/disagreement",), {"doubt_pixels": False}, (SCAN, MASKS)
    ),
    "unmix": Mechanism("mixed pixels", ("scene/unmixing", "scene/fragments"), {"unmix": False}),
    "unmeshed_lamps": Mechanism("lamps without a mesh", ("views/unmeshed",), {"unmeshed_lamps": False}),
    "reject_views": Mechanism(
        "misaligned views", ("views/alignment", "views/registration"), {"reject_views": False}
    ),
    "correct_exposure": Mechanism("unlike exposures", ("views/exposure",), {"correct_exposure": False}),
    "clipped_lamps": Mechanism(
        "clipped lamps by their light", ("views/clipped_surfaces", "light/clipped"), {"clipped_lamps": False},
        (JPEG,)
    ),
    "refit_photographs": Mechanism(
        "codes again with baked light", ("views/refit",), {"refit_photographs": False}, (JPEG,)
    ),
    "unseen_light": Mechanism("light from unseen directions", ("light/unseen_light",), {"unseen_light": False}),
    "presumed_lamps": Mechanism("presumed lamps", ("light/presumed",), {"presumed_lamps": False}),
    "lit_specks": Mechanism("fixtures that others light", ("light/scan_fixtures",), {"lit_specks": False}, (SCAN,)),
    "denoise_specular": Mechanism("denoised specular shadings", (), {"denoise_specular": False}),
    "constant_parts": Mechanism("parts of constant radiance", (), {"constant_parts": False}, (MASKS,)),
    "lamp_outlines": Mechanism("outlines of lamps", ("light/lamp_outline",), {"lamp_outlines": False}, (SCAN,)),
    "reflecting_lamps": Mechanism("lamps that reflect", ("light/reflecting",), {"reflecting_lamps": False}),
    "lamp_doubt": Mechanism("doubt of the light in the confidence", ("light/lamp_doubt",), {"lamp_doubt": False}, (SCAN,)),
    "stage_3": Mechanism("(the paper's) stage 3", (), {"rounds": 0}),
    "training": Mechanism("(the paper's) training", (), {"training_steps": 1}),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A capture of the jury: see the module's docstring."""

    room: str
    mesh: str
    light: str
    masks: str

    @property
    def name(self) -> str:
        """As on the command line."""
        return ":".join((self.room, self.mesh, self.light, self.masks))

    @property
    def folder(self) -> str:
        """Name for files."""
        return self.name.replace(":", "-")

    @property
    def voxel(self) -> float | None:
        """Metres; None where the mesh is exact."""
        return None if self.mesh == "exact" else float(self.mesh.removesuffix("cm")) / 100.0

    def has(self, needs: Sequence[str]) -> bool:
        """Whether it has what a mechanism needs."""
        scan = {SCAN} if self.voxel is not None else set()
        masked = {MASKS} if self.masks != NO_MASKS else set()
        return set(needs) <= {self.light, self.masks} | scan | masked


def cases(text: str) -> list[Case]:
    """The captures that ROOM:MESH:LIGHT:MASKS stands for.

    Raises:
        FiptError: ``trial-unknown``.
    """
    found = []
    for word in text.split():
        fields = [part.split(",") for part in word.split(":")]
        if len(fields) != 4:
            raise FiptError("trial-unknown", f"{word} is no capture.", "Write ROOM:MESH:LIGHT:MASKS.")
        found += [Case(*values) for values in itertools.product(*fields)]
    for case in found:
        mesh = case.mesh == "exact" or case.mesh.removesuffix("cm").replace(".", "", 1).isdigit()
        if not mesh or case.light not in ("hdr", JPEG) or case.masks not in (SHARED, OWN, NO_MASKS):
            raise FiptError(
                "trial-unknown",
                f"{case.name} is no capture.",
                "Use exact, 2cm; hdr, jpeg; parts, linked, none.",
            )
    return found


@dataclass(frozen=True)
class Change:
    """How a run differs from the method as it is.

    Attributes:
        name: of the mechanism that is off, or "module.NAME*factor".
        settings: that differ. constants: by "module.NAME".
        needs: of a capture.
        begins: folder of what the capture's first run has left with which it begins, "" for its input alone.
    """

    name: str = BASE
    settings: Mapping[str, Any] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    begins: str = BAKED


_MESH_SETTINGS = ("clean_scan", "close_holes_edges")
_COMPLETION_SETTINGS = ("panes", "lost_parts", "lost_surfaces", "torn_parts", "outlines")


def without(name: str) -> Change:
    """A mechanism off, or ``seed``: the method with another seed.

    Raises:
        FiptError: ``trial-unknown``.
    """
    if name.startswith("seed"):
        return Change(name, {"seed": int(name.removeprefix("seed") or 1)}, begins=COMPLETED)
    if name not in MECHANISMS:
        raise FiptError("trial-unknown", f"There is no mechanism {name}.", "See --list.")
    mechanism = MECHANISMS[name]
    begins = BAKED
    if any(key in _COMPLETION_SETTINGS for key in mechanism.off):
        begins = CLEANED
    if any(key in _MESH_SETTINGS for key in mechanism.off):
        begins = ""
    return Change(name, mechanism.off, {}, mechanism.needs, begins)


def scaled(constant: Constant, factor: float) -> Change:
    """A number times a factor."""
    room = constant.module.partition(".")[0]
    begins = BAKED if room in AFTER_SHADINGS else COMPLETED if room in AFTER_MESH else ""
    return Change(f"{constant.key}*{factor:g}", {}, {constant.key: constant.scaled(factor)}, (), begins)


class Trial:
    """The jury's captures and runs below a folder.

    Args:
        work: the folder.
        rooms: name to capture.
        settings: changed ones of all runs.
        seed: of scans, cameras and masks.
    """

    def __init__(
        self, work: Path, rooms: Mapping[str, Path], settings: Mapping[str, Any], seed: int = 0
    ) -> None:
        self.work, self.rooms, self.settings, self.seed = work.absolute(), dict(rooms), dict(settings), seed
        self.lines = self.work / "runs.jsonl"

    def finished(self) -> list[dict[str, Any]]:
        """The finished runs of the present method with these settings."""
        if not self.lines.exists():
            return []
        rows = [json.loads(line) for line in self.lines.read_text(encoding="utf-8").splitlines()]
        wanted = {"method": method_digest(), "settings": self.settings, "seed": self.seed}
        return [row for row in rows if {name: row[name] for name in wanted} == wanted]

    def capture(self, case: Case) -> Path:
        """The folder of a capture with its photographs and masks, made if it is missing."""
        made = self.rooms[case.room].absolute()
        if case.masks == OWN:
            source, made = made, self.work / "captures" / f"{case.room}-{OWN}-{self.seed}"
            if not made.exists():
                own_masks.make_capture(source, made, own_masks.Faults(), self.seed)
        if case.light == JPEG:
            source, made = made, self.work / "captures" / f"{made.name}-{JPEG}-{self.seed}"
            if not made.exists():
                ldr.make_capture(source, made, self.seed)
        return made

    def scan(self, case: Case) -> Path | None:
        """The scanned mesh of a capture, made if it is missing; None for the exact one."""
        if case.voxel is None:
            return None
        mesh = self.work / "scans" / f"{case.room}-{case.mesh}-{self.seed}.ply"
        if not mesh.exists():
            options = ["--voxel", str(case.voxel), "--seed", str(self.seed)]
            accuracy.scan_capture(self.rooms[case.room], mesh, options)
        return mesh

    def prepared(self, case: Case, capture: Path) -> RunFolder:
        """The run folder with a capture's input, made if it is missing."""
        run = RunFolder(self.work / "prepared" / f"{case.folder}-{self.seed}")
        if not run.room_npz.exists():
            mesh = self.scan(case)
            options = ["--parts", "none" if case.masks == NO_MASKS else "auto"]
            prepared.prepare(capture, run.root, options + (["--mesh", str(mesh)] if mesh else []))
        return run

    def do(self, case: Case, change: Change) -> None:
        """Do one run, and add its line.

        Raises:
            FiptError: ``run-failed``, and those of making the capture.
        """
        capture = self.capture(case)
        source = self.prepared(case, capture)
        store = self.work / "stored" / f"{case.folder}-{self.seed}-{method_digest()[:8]}"
        run = RunFolder(self.work / "run")
        prepared.clear(run)
        prepared.copy_input(source, run, make_settings("draft", {**self.settings, **change.settings}))
        options = ["--constants", json.dumps(dict(change.constants))]
        if change.name == BASE:
            options += ["--store", str(store)]
        elif change.begins == CLEANED:
            copy_files(store / CLEANED, run.root, CLEANED_FILES)
        elif change.begins:
            copy_files(store / COMPLETED, run.root, COMPLETED_FILES)
            if change.begins == BAKED:
                shutil.copytree(store / BAKED, run.stage, dirs_exist_ok=True)
        command = [sys.executable, str(ROOT / "benchmarks" / "trial_run.py"), str(run.root), str(capture)]
        with run.log.open("a", encoding="utf-8") as log:
            ended = subprocess.run([*command, *options], stdout=log, stderr=log, check=False)
        row = {"capture": case.name, "change": change.name, "method": method_digest()}
        row |= {"settings": self.settings, "seed": self.seed}
        if ended.returncode:
            failed = self.work / "failed"
            shutil.rmtree(failed, ignore_errors=True)
            shutil.copytree(run.root, failed)
            row |= {"error": run.log.read_text(encoding="utf-8").strip().splitlines()[-1:]}
        else:
            row |= json.loads((run.root / "trial.json").read_text(encoding="utf-8"))
        with self.lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def pending(self, chosen: Sequence[Case], changes: Sequence[Change]) -> Iterator[tuple[Case, Change]]:
        """The runs that are missing, the method as it is before the others of a capture."""
        done = {(row["capture"], row["change"]): "error" in row for row in self.finished()}
        for change in changes:
            for case in chosen:
                if done.get((case.name, BASE)) or not case.has(change.needs):
                    continue
                for each in (Change(), change):
                    if (case.name, each.name) not in done:
                        done[case.name, each.name] = False
                        yield case, each


def held_back(row: Mapping[str, Any]) -> dict[str, float | None]:
    """The figures of COLUMNS of a run: maps of all views that are scored, renders of those held back."""
    figures = row["figures"]["held_back"]
    return {name: figures.get(name) for name in COLUMNS}


@dataclass(frozen=True)
class Effect:
    """What a change does, over the captures where it does anything.

    Attributes:
        captures: how many it was tried on, and how many have other figures for it.
        gains: (captures, columns) figures of the method as it is minus those with the change; NaN for none.
        seconds: mean processor time that the method as it is takes more, of the steps that both did.
    """

    tried: int
    acted: int
    gains: np.ndarray
    seconds: float

    @property
    def mean(self) -> np.ndarray:
        """(columns,) mean gain; 0 without any capture."""
        return self.gains.mean(axis=0) if self.acted else np.zeros(len(COLUMNS))

    def verdict(self) -> str:
        """By the rule: a gain that counts in some column, and not as much lost in another."""
        if not self.acted:
            return "did nothing"
        shares = self.mean / np.array(list(COLUMNS.values()))
        if shares.max() >= 1.0:
            return "pays" if -shares.min() < shares.max() else "loses as much"
        return "harms" if shares.min() <= -1.0 else "does not pay"


def effects(rows: Sequence[Mapping[str, Any]]) -> dict[str, Effect]:
    """The effect of each change among finished runs, by its name."""
    good = [row for row in rows if "figures" in row]
    base = {row["capture"]: row for row in good if row["change"] == BASE}
    gains: dict[str, list[np.ndarray]] = defaultdict(list)
    seconds: dict[str, list[float]] = defaultdict(list)
    for row in good:
        if row["change"] == BASE or row["capture"] not in base:
            continue
        first = base[row["capture"]]
        one, other = held_back(first), held_back(row)
        pairs = [(one[name], other[name]) for name in COLUMNS]
        gains[row["change"]].append(
            np.array([np.nan if None in pair else pair[0] - pair[1] for pair in pairs])
        )
        both = first["seconds"].keys() & row["seconds"].keys()
        seconds[row["change"]].append(sum(first["seconds"][step] - row["seconds"][step] for step in both))
    found = {}
    for name, each in gains.items():
        table = np.nan_to_num(np.array(each))
        acted = np.abs(table).max(axis=1) > 0.0
        found[name] = Effect(len(each), int(acted.sum()), table[acted], float(np.mean(seconds[name])))
    return found


def lines_of(name: str) -> int:
    """Lines of the modules of a mechanism."""
    modules = MECHANISMS[name].modules if name in MECHANISMS else ()
    return sum(len((CORE / f"{module}.py").read_text(encoding="utf-8").splitlines()) for module in modules)


def format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row for each mechanism, with its mean gains, its worst loss, its price and the verdict."""
    head = ["off", "captures", *TITLES, "worst", "seconds", "lines", "verdict"]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    found = effects(rows)
    order = [name for name in MECHANISMS if name in found] + [
        name for name in found if name not in MECHANISMS
    ]
    for name in order:
        effect = found[name]
        cells = [f"`{name}`", f"{effect.acted} of {effect.tried}"]
        cells += [_number(value, least) for value, least in zip(effect.mean, COLUMNS.values(), strict=True)]
        cells += [worst(effect), f"{effect.seconds:.0f}", str(lines_of(name) or "-")]
        cells.append(effect.verdict() if name in MECHANISMS else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def worst(effect: Effect) -> str:
    """The largest loss of one capture, in terms of what counts, and its column."""
    if not effect.acted:
        return "-"
    least = np.array(list(COLUMNS.values()))
    shares = effect.gains / least
    row, column = np.unravel_index(int(shares.argmin()), shares.shape)
    value = float(effect.gains[row, column])
    return f"{TITLES[column]} {_number(value, least[column])}" if value < 0.0 else "-"


def _number(value: float, least: float) -> str:
    return f"{value:+.3f}".replace("-", "−") if least < 0.1 else f"{value:+.2f}".replace("-", "−")


def format_list() -> str:
    """The mechanisms with their lines, and the numbers with their comments."""
    text = [f"{name:20s} {lines_of(name):5d} lines  {each.text}" for name, each in MECHANISMS.items()]
    text += [f"{each.key:60s} {each.value:<12g} {each.comment}" for each in all_constants()]
    return "\n".join(text)


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
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of all runs")
    add("--seed", type=int, default=0, help="of scans, cameras and faults of masks")
    add("--most", type=int, metavar="N", help="do at most so many runs")
    add("--table", type=Path, metavar="FILE", help="also write the table of the finished runs to a file")
    return parser


def changes_of(off: str, numbers: str) -> list[Change]:
    """The changes that two options name.

    Raises:
        FiptError: ``trial-unknown``.
    """
    names = list(MECHANISMS) if off == "all" else [name for name in off.split(",") if name]
    changes = [without(name) for name in names]
    every = all_constants()
    for prefix in (word for word in numbers.split(",") if word):
        chosen = [each for each in every if each.key.startswith(prefix)]
        if not chosen:
            raise FiptError("trial-unknown", f"There is no number {prefix}.", "See --list.")
        changes += [scaled(each, factor) for each in chosen for factor in FACTORS]
    return changes


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
        trial = Trial(arguments.work, rooms, settings, arguments.seed)
        chosen, changes = cases(arguments.captures), changes_of(arguments.off, arguments.numbers)
        unknown = {case.room for case in chosen} - rooms.keys()
        if unknown:
            raise FiptError("trial-unknown", f"No --room names {', '.join(unknown)}.", "Name its folder.")
        for case, change in itertools.islice(trial.pending(chosen, changes or [Change()]), arguments.most):
            print(f"== {case.name} {change.name or 'as it is'}", file=sys.stderr, flush=True)
            trial.do(case, change)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    rows = trial.finished()
    text = format_table(rows)
    print(text)
    if arguments.table:
        arguments.table.write_text(text + "\n", encoding="utf-8")
    return 1 if any("error" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
