# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each mechanism brings: estimates with one mechanism off, or one number halved or doubled, on a jury.

    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none,parts --off torn_parts,outlines
    python benchmarks/trial.py WORK --room a=DIR --captures a:2cm:hdr:none --numbers views.torn_parts
    python benchmarks/trial.py WORK --table results.md
    python benchmarks/trial.py --list

A capture of the jury is a room (a capture with ground truth in the FIPT authors' synthetic layout), its mesh
(exact, disturbed by 1 cm as in the paper, or scanned with voxels of so many centimetres), its photographs
(hdr, jpeg) and its masks (parts, linked: masks of single photographs with faults, semantics, none); several
words divided by commas stand for all of them. Numbers are module constants (views.torn_parts.LEAST_VIEWS) and
settings (settings.view_error).
WORK gets the captures, what runs begin with, and runs.jsonl, a line for each finished run; finished runs are
not repeated. A run begins with the stages of the capture's first run that do not depend on what differs.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy, disturb, ldr, metrics, own_masks, prepared
from benchmarks.constants import CORE, Constant, all_constants
from benchmarks.trial_run import BAKED, CLEANED, CLEANED_FILES, COMPLETED, COMPLETED_FILES, copy_files
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.method import method_digest
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings, make_settings

ROOT = Path(__file__).resolve().parent.parent
SCAN, JPEG, MASKS, SHARED, OWN, NO_MASKS = "scan", "jpeg", "masks", "parts", "linked", "none"
EXACT, DISTURBED, SIGMA = "exact", "disturbed", 0.01  # metres, as in the paper
PARTS = {SHARED: "auto", OWN: "auto", "semantics": "semantics", NO_MASKS: "none"}  # as `estimate` has them
FACTORS = (0.5, 2.0)
SETTINGS = "settings"
BASE = ""  # the method as it is
# Figures of the table, and the gain from which on one counts (dB, IoU).
COLUMNS = {
    "kd_psnr": 0.3, "a_prime_psnr": 0.3, "sigma_psnr": 0.3, "metallic_psnr": 0.3, "emission_iou": 0.02,
    "view_synthesis_psnr": 0.3, "relight_psnr": 0.3, "confidence": 1.0,
}  # fmt: skip
TITLES = ("kd", "a′", "σ", "metallic", "IoU", "re-rendered", "relit", "confidence")
SPLITS = ("training", "held_back")
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


_GEOMETRY = ("clean", "planes", "normals", "patches", "roughness")
_TABLE = (
    # name, what it does, modules that only it needs, settings without it, what a capture must have
    (
        "clean_scan",
        "a scan is cleaned, and not trusted as a modelled mesh is",
        [f"geometry/{name}" for name in _GEOMETRY],
        {"clean_scan": False},
        (SCAN,),
    ),
    ("closing", "small holes are closed", ["geometry/closing"], {"close_holes_edges": 0}, (SCAN,)),
    ("panes", "panes in flat holes", ["geometry/holes"], {}, (SCAN,)),
    ("lost_parts", "prisms for lost parts", ["views/lost_parts", "geometry/prism"], {}, (SCAN, SHARED)),
    ("lost_surfaces", "lost things by colors", ["views/lost_surfaces", "views/agreement"], {}, (SCAN,)),
    (
        "torn_parts",
        "torn parts are completed",
        ["views/torn_parts", "geometry/revolution", "geometry/sheet"],
        {},
        (SCAN, MASKS),
    ),
    ("outlines", "outlines of parts", ["scene/outlines", "scene/outline_misses"], {}, (SCAN, MASKS)),
    ("doubt_pixels", "doubt where mask and scan disagree", ["scene/disagreement"], {}, (SCAN, MASKS)),
    ("unmix", "mixed pixels are used", ["scene/unmixing", "scene/fragments"], {}, ()),
    ("unmeshed_lamps", "lamps without a mesh are left out", ["views/unmeshed"], {}, ()),
    ("reject_views", "misaligned views are left out", ["views/misaligned", "views/registration"], {}, ()),
    ("correct_exposure", "unlike exposures are corrected", ["views/exposure"], {}, ()),
    (
        "clipped_lamps",
        "clipped lamps by the light that they cast",
        ["views/clipped_surfaces", "light/clipped"],
        {},
        (JPEG,),
    ),
    ("refit_photographs", "codes again with baked light", ["views/refit"], {}, (JPEG,)),
    ("unseen_light", "light from unseen directions", ["light/unseen_light"], {}, ()),
    ("presumed_lamps", "presumed lamps in stage 1", ["light/presumed"], {}, ()),
    ("denoise_specular", "denoised specular shadings", [], {}, ()),
    ("reflecting_lamps", "lamps reflect", ["light/reflecting"], {}, ()),
    ("lamp_doubt", "the place of lamps in the confidence", ["light/lamp_doubt"], {}, (SCAN,)),
)
MECHANISMS = {
    name: Mechanism(text, tuple(modules), off or {name: False}, needs)
    for name, text, modules, off, needs in _TABLE
}
# The paper's own steps and choices without which it has ablations (docs/method.md).
ABLATIONS: dict[str, dict[str, Any]] = {
    "joint-emission": {"emission": "joint"},
    "no-stage-3": {"rounds": 0},
    "no-cache": {"refine_cache": False},
    "fewer-views": {"view_share": 0.3},
    "cycles-g": {"masking": "smith"},
}


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
        """Metres; None where the mesh is no scan."""
        return None if self.mesh in (EXACT, DISTURBED) else float(self.mesh.removesuffix("cm")) / 100.0

    def has(self, needs: Sequence[str]) -> bool:
        """Whether it has what a mechanism needs."""
        scan = {SCAN} if self.voxel is not None else set()
        masked = {MASKS} if self.masks in (SHARED, OWN) else set()
        return set(needs) <= {self.light, self.masks} | scan | masked


def cases(text: str) -> list[Case]:
    """The captures that ROOM:MESH:LIGHT:MASKS stands for.

    Raises:
        FiptError: ``trial-unknown``.
    """
    found = []
    for word in text.split():
        choices = [part.split(",") for part in word.split(":")]
        if len(choices) != 4:
            raise FiptError("trial-unknown", f"{word} is no capture.", "Write ROOM:MESH:LIGHT:MASKS.")
        found += [Case(*values) for values in itertools.product(*choices)]
    for case in found:
        mesh = re.fullmatch(rf"{EXACT}|{DISTURBED}|\d+(\.\d+)?cm", case.mesh)
        if not mesh or case.light not in ("hdr", JPEG) or case.masks not in PARTS:
            raise FiptError(
                "trial-unknown",
                f"{case.name} is no capture.",
                "Use exact, disturbed, 2cm; hdr, jpeg; parts, linked, semantics, none.",
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
    """A mechanism off, an ablation, or ``seed1``: the method with another seed.

    Raises:
        FiptError: ``trial-unknown``.
    """
    if name.startswith("seed"):
        return Change(name, {"seed": int(name.removeprefix("seed") or 1)}, begins=COMPLETED)
    if name in ABLATIONS:
        return Change(name, ABLATIONS[name], begins="" if "view_share" in ABLATIONS[name] else BAKED)
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
    value = constant.scaled(factor)
    if constant.module == SETTINGS:
        begins = "" if constant.name in _MESH_SETTINGS else BAKED
        return Change(f"{constant.key}*{factor:g}", {constant.name: value}, begins=begins)
    room = constant.module.partition(".")[0]
    begins = BAKED if room in AFTER_SHADINGS else COMPLETED if room in AFTER_MESH else ""
    return Change(f"{constant.key}*{factor:g}", {}, {constant.key: value}, (), begins)


def all_numbers(preset: str = "draft") -> list[Constant]:
    """The settings of a preset that are numbers and decide something, and the engine's constants."""
    settings = make_settings(preset)
    found = [
        Constant(SETTINGS, item.name, getattr(settings, item.name), item.metadata["help"])
        for item in fields(Settings)
        if type(item.default) in (int, float) and item.metadata["stage"] and item.name != "seed"
    ]
    return found + all_constants()


class Trial:
    """The jury's captures and runs below a folder.

    Args:
        work: the folder.
        rooms: name to capture.
        settings: changed ones of all runs. preset: of all runs.
        seed: of scans, cameras and masks.
    """

    def __init__(
        self,
        work: Path,
        rooms: Mapping[str, Path],
        settings: Mapping[str, Any],
        seed: int = 0,
        preset: str = "draft",
    ) -> None:
        self.preset = preset
        self.work, self.rooms, self.settings, self.seed = work.absolute(), dict(rooms), dict(settings), seed
        self.lines = self.work / "runs.jsonl"

    def finished(self) -> list[dict[str, Any]]:
        """The finished runs of the present method with these settings."""
        if not self.lines.exists():
            return []
        rows = [json.loads(line) for line in self.lines.read_text(encoding="utf-8").splitlines()]
        wanted = {"method": method_digest(), **self._made_with}
        return [row for row in rows if {name: row.get(name, self.preset) for name in wanted} == wanted]

    @property
    def _made_with(self) -> dict[str, Any]:
        return {"settings": self.settings, "seed": self.seed, "preset": self.preset}

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

    def mesh(self, case: Case) -> Path | None:
        """The scanned or disturbed mesh of a capture, made if it is missing; None for the exact one."""
        if case.mesh == DISTURBED:
            mesh = self.work / "scans" / f"{case.room}-{DISTURBED}.obj"
            if not mesh.exists():
                mesh.parent.mkdir(parents=True, exist_ok=True)
                disturb.disturb_obj(self.rooms[case.room] / "scene.obj", mesh, SIGMA)
            return mesh
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
            mesh, options = self.mesh(case), ["--parts", PARTS[case.masks]]
            prepared.prepare(capture, run.root, options + (["--mesh", str(mesh)] if mesh else []))
        return run

    def do(self, case: Case, change: Change) -> None:
        """Do one run, and add its line.

        Raises:
            FiptError: ``run-failed``, and those of making the capture.
        """
        capture = self.capture(case)
        source = self.prepared(case, capture)
        store = self.work / "stored" / f"{case.folder}-{self.seed}-{self.preset}-{method_digest()[:8]}"
        run = RunFolder(self.work / "run")
        prepared.clear(run)
        prepared.copy_input(source, run, make_settings(self.preset, {**self.settings, **change.settings}))
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
        row |= self._made_with
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


def figures_of(row: Mapping[str, Any]) -> dict[str, float | None]:
    """The figures of COLUMNS of a run, the paper's protocol.

    Those of maps are means of training and held-back views, as few small views are held back, and the truth
    of neither is used. Renders are of those held back. `confidence` compares expected and made errors of base
    colour: dB of the mean squared difference over its classes.
    """
    found: dict[str, float | None] = {}
    for name in COLUMNS:
        values = [row["figures"][split].get(name) for split in SPLITS]
        known = [float(value) for value in values if isinstance(value, int | float)]
        found[name] = float(np.mean(known)) if known else None
    classes = row["figures"]["held_back"].get("confidence") or []
    squared = sum(each["share"] * (each["expected"] - each["made"]) ** 2 for each in classes)
    found["confidence"] = metrics.psnr(squared / sum(each["share"] for each in classes)) if classes else None
    return found


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
        one, other = figures_of(first), figures_of(row)
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
    text += [f"{each.key:60s} {each.value:<12g} {each.comment}" for each in all_numbers()]
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
    add("--preset", default="draft", help="draft, medium or high (default: draft)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of all runs")
    add("--seed", type=int, default=0, help="of scans, cameras and faults of masks")
    add("--most", type=int, metavar="N", help="do at most so many runs")
    add("--table", type=Path, metavar="FILE", help="also write the table of the finished runs to a file")
    return parser


def changes_of(off: str, numbers: str, preset: str) -> list[Change]:
    """The changes that two options name.

    Raises:
        FiptError: ``trial-unknown``.
    """
    names = list(MECHANISMS) if off == "all" else [name for name in off.split(",") if name]
    changes = [without(name) for name in names]
    every = all_numbers(preset)
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
        trial = Trial(arguments.work, rooms, settings, arguments.seed, arguments.preset)
        chosen = cases(arguments.captures)
        changes = changes_of(arguments.off, arguments.numbers, arguments.preset)
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
