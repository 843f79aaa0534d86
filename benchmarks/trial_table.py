"""The table of benchmarks/trial.py: what each change does to the figures of a jury's captures."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import metrics
from benchmarks.trial_changes import BASE, MECHANISMS, SEED, lines_of

# Figures of the table, and the gain from which on one counts (dB, IoU, lamps) if seeds change less.
COLUMNS = {
    "kd_psnr": 0.3, "a_prime_psnr": 0.3, "sigma_psnr": 0.3, "metallic_psnr": 0.3, "emission_iou": 0.02,
    "view_synthesis_psnr": 0.3, "relight_psnr": 0.3, "confidence": 1.0, "false": 1.0, "lost": 0.5,
}  # fmt: skip
TITLES = (
    "kd", "a′", "σ", "metallic", "IoU", "re-rendered", "relit", "confidence", "false lamps", "lost lamps",
)  # fmt: skip
LAMPS = ("false", "lost")  # counts, of which fewer are better
SPLITS = ("training", "held_back")


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
    # Runs of captures that do not tell their lamps have none.
    found |= {name: -float(row["lamps"][name]) for name in LAMPS if row.get("lamps")}
    squared = sum(each["share"] * (each["expected"] - each["made"]) ** 2 for each in classes)
    found["confidence"] = metrics.psnr(squared / sum(each["share"] for each in classes)) if classes else None
    return found


@dataclass(frozen=True)
class Effect:
    """What a change does, over the captures where it does anything.

    Attributes:
        tried: captures with a run of it. acted: those that have other figures for it.
        gains: (acted, columns) figures of the method as it is minus those with the change.
        noise: (columns,) what another seed changes there, mean; 0 in captures without one.
        seconds: mean processor time that the method as it is takes more, of the steps that both did.
    """

    tried: int
    acted: int
    gains: np.ndarray
    noise: np.ndarray
    seconds: float

    @property
    def mean(self) -> np.ndarray:
        """(columns,) mean gain; 0 without any capture."""
        return self.gains.mean(axis=0) if self.acted else np.zeros(len(COLUMNS))

    def verdict(self) -> str:
        """By the rule: a gain that counts in some column, and not as much lost in another."""
        if not self.acted:
            return "did nothing"
        shares = self.mean / np.maximum(list(COLUMNS.values()), self.noise)
        if shares.max() >= 1.0:
            return "pays" if -shares.min() < shares.max() else "loses as much"
        return "harms" if shares.min() <= -1.0 else "does not pay"


def effects(rows: Sequence[Mapping[str, Any]]) -> dict[str, Effect]:
    """The effect of each change among finished runs, by its name."""
    good = [row for row in rows if "figures" in row]
    base = {row["capture"]: row for row in good if row["change"] == BASE}
    pairs = [(row, base[row["capture"]]) for row in good if row["change"] != BASE and row["capture"] in base]
    gains: dict[str, dict[str, np.ndarray]] = defaultdict(dict)
    seconds: dict[str, list[float]] = defaultdict(list)
    noise: dict[str, np.ndarray] = {}
    for row, first in pairs:
        name, capture = row["change"], row["capture"]
        one, other = figures_of(first), figures_of(row)
        both = [(one[column], other[column]) for column in COLUMNS]
        gain = np.array([0.0 if x is None or y is None else x - y for x, y in both])
        gains[name][capture] = gain
        if name.startswith(SEED):
            noise[capture] = np.maximum(noise.get(capture, 0.0), np.abs(gain))
        steps = first["seconds"].keys() & row["seconds"].keys()
        seconds[name].append(sum(first["seconds"][step] - row["seconds"][step] for step in steps))
    found = {}
    for name, each in gains.items():
        acted = [capture for capture, gain in each.items() if gain.any()]
        table, none = np.array([each[capture] for capture in acted]), np.zeros(len(COLUMNS))
        usual = np.mean([noise.get(capture, none) for capture in acted], axis=0) if acted else none
        found[name] = Effect(len(each), len(acted), table, usual, float(np.mean(seconds[name])))
    return found


def as_table(rows: Sequence[Mapping[str, Any]], common: Mapping[str, Any]) -> dict[str, Any]:
    """A row for each mechanism, with its mean gains, its worst loss, its price and the verdict.

    Args:
        common: where the runs come from; see benchmarks/results.py, which writes the table.
    """
    forms = [f"{{{name}:{'+.3f' if least < 0.1 else '+.2f'}}}" for name, least in COLUMNS.items()]
    others = (
        ("worst", "{worst}"),
        ("seconds", "{seconds:.0f}"),
        ("lines", "{lines}"),
        ("verdict", "{verdict}"),
    )
    columns = [["captures", "{captures}"], *map(list, zip(TITLES, forms, strict=True)), *map(list, others)]
    found = effects(rows)
    order = [name for name in MECHANISMS if name in found]
    order += [name for name in found if name not in MECHANISMS]
    made = []
    for name in order:
        effect = found[name]
        figures = {"captures": f"{effect.acted} of {effect.tried}"}
        figures |= dict(zip(COLUMNS, effect.mean.round(4).tolist(), strict=True))
        figures |= {
            "worst": worst(effect),
            "seconds": round(effect.seconds, 1),
            "lines": lines_of(name) or None,
        }
        figures |= {"verdict": effect.verdict() if name in MECHANISMS else None}
        made.append({"label": f"`{name}`", "figures": figures})
    return {"first": "off", "columns": columns, "common": dict(common), "rows": made}


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
