# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much the closed-form estimate depends on its settings: each one halved and doubled, on finished runs.

python benchmarks/sensitivity.py RUN ... --settings NAME,NAME

The runs have kept their stage folders, and their captures have ground truth. Nothing is baked or trained:
each variant estimates roughness, metallic and base colour of the training pixels anew from stored shadings.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import metrics, truth
from benchmarks.metrics import ClosedForm
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import Settings

FACTORS = (0.5, 2.0)
COLUMNS = ("kd_psnr", "sigma_psnr", "metallic_psnr")


@dataclass(frozen=True)
class Variant:
    """Settings, and what to call them."""

    label: str
    settings: Settings


def variants(settings: Settings, names: Sequence[str], seeds: int) -> list[Variant]:
    """The settings as they are, with other seeds (`seeds` in all), and with each of `names` halved, doubled.

    Raises:
        FiptError: ``setting-unknown`` if a name is none of a number's.
    """
    made = [Variant("as it is", settings)]
    made += [Variant(f"seed {seed}", replace(settings, seed=seed)) for seed in range(1, seeds)]
    for name in names:
        value = getattr(settings, name, None)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FiptError("setting-unknown", f"{name} is no numeric setting.", "Name settings of the run.")
        for factor in FACTORS:
            changed = value * factor if isinstance(value, float) else max(1, round(value * factor))
            made.append(Variant(f"{name} = {changed:g}", replace(settings, **{name: changed})))
    return made


def scores(found: ClosedForm, true: metrics.Maps) -> dict[str, float | None]:
    """PSNR in dB (strict protocol) of kd, sigma and metallic over the pixels of `true`; maps are (P, 1)."""
    plain, diffuse = metrics.surfaces(true), metrics.diffuse_surfaces(true)
    sampled = np.zeros(len(plain), bool)
    sampled[found.rows] = True
    kd = np.zeros_like(true.kd)
    kd[found.rows, 0] = found.kd
    known = plain & np.isfinite(found.roughness)[:, None]
    pairs = ((kd, true.kd, diffuse & sampled[:, None]), (found.roughness[:, None], true.roughness, known))
    pairs += ((found.metallic[:, None], true.metallic, known),)
    values = [metrics.pooled_psnr([one], [other], [kept], strict=True) for one, other, kept in pairs]
    return dict(zip(COLUMNS, values, strict=True))


def joined(maps: Sequence[metrics.Maps]) -> metrics.Maps:
    """True maps of several views as one of (P, 1) pixels."""
    names = ("kd", "a_prime", "base_color", "roughness", "metallic", "emission", "hit")
    arrays = {}
    for name in names:
        images = [getattr(view, name) for view in maps]
        arrays[name] = np.concatenate([image.reshape(-1, 1, *image.shape[2:]) for image in images])
    return metrics.Maps(**arrays)


def measure(run: RunFolder, names: Sequence[str], seeds: int) -> dict[str, dict[str, float | None]]:
    """Scores of each variant's label for one run.

    Raises:
        FiptError: ``setting-unknown``, ``truth-missing``, or where the run's stages can't be read.
    """
    settings = run.read()
    chosen = variants(settings, names, seeds)
    set_variant(settings.device)
    from benchmarks.stored import StoredEstimate

    with tempfile.TemporaryDirectory() as scratch:
        stored = StoredEstimate(run, settings, Path(scratch))
        true = joined([truth.read_maps(view) for view in stored.views])
        return {each.label: scores(stored.closed_form(each.settings), true) for each in chosen}


def format_table(results: dict[str, dict[str, dict[str, float | None]]]) -> str:
    """Markdown: a row for each variant, kd / sigma / metallic for each run."""
    labels = list(next(iter(results.values())))
    lines = ["| kd / σ / metallic | " + " | ".join(results) + " |", "|---" * (len(results) + 1) + "|"]
    for label in labels:
        cells = []
        for of_run in results.values():
            values = [of_run[label][name] for name in COLUMNS] if label in of_run else []
            cells.append(" / ".join("-" if value is None else f"{value:.2f}" for value in values))
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, or 1 after an error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--settings", default="", metavar="NAME,NAME", help="settings to halve and double")
    parser.add_argument("--seeds", type=int, default=3, help="seeds to compare (default: 3)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    arguments = parser.parse_args(list(argv))
    names = [name for name in arguments.settings.split(",") if name]
    try:
        results = {root.name: measure(RunFolder(root), names, arguments.seeds) for root in arguments.runs}
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    print(format_table(results))
    if arguments.json:
        write_json(arguments.json.absolute(), results)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
