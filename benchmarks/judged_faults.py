# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a result that judges itself names the fault that was built in: `judged_faults.py DIR [FAULT ...]`.

A box of coloured patches with a table, a crate and a ceiling panel is photographed (path traced, 14 views of
96 x 64), of which three are held back. Each fault changes photographs, cameras or mesh before the estimation.
One line for each: the figure that the result gives of itself, the same figure of an independent path tracer
on true photographs (comparable where these and their cameras have no fault), the causes, and whether the
first is right. A capture that is refused counts by the code of its error.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.result_contents import QualityFigures, Statistics
from fipt_blender.core.run.runfolder import RunFolder

if TYPE_CHECKING:
    from benchmarks.faulty_rooms import Case
    from samples.small_captures import SmallCapture


def true_db(run: RunFolder, truth: SmallCapture) -> float:
    """PSNR of the views that were held back, rendered by another path tracer, against true photographs."""
    from benchmarks.faulty_rooms import HELD_BACK
    from benchmarks.predict import load_result
    from benchmarks.tracer.forward import RenderSettings, render_view
    from fipt_blender.core.capture.views import load_capture
    from fipt_blender.core.checks.quality import GAMMA, MIDDLE, Display

    lit, _ = load_result(run)
    scale = read_document(run.statistics_json, Statistics).radiance_scale
    errors, display = [], Display()
    for index, view in zip(HELD_BACK, load_capture(run).held_back, strict=True):
        found = render_view(lit, view, RenderSettings(spp=256, depth=10, denoise=True), index) / scale
        true = np.clip(truth.images[index] * (MIDDLE / scale), 0.0, 1.0) ** GAMMA
        errors.append(((display.shown(found, view, display.factor(true, found, view)) - true) ** 2).mean())
    return float(-10.0 * np.log10(np.mean(errors)))


def row(name: str, case: Case, right: set[str], root: Path, truth: SmallCapture) -> tuple[str, bool]:
    """A line of the table, and whether the first cause is right."""
    from benchmarks.faulty_rooms import estimated
    from fipt_blender.core.checks.quality import POOR

    try:
        run = estimated(case, root)
    except FiptError as error:
        return f"| {name} | - | - | refused: {error.code} | {error.code in right} |", error.code in right
    quality = read_document(run.quality_json, QualityFigures)
    causes = ", ".join(f"{cause.name} {100.0 * cause.share:.0f} %" for cause in quality.causes)
    good = quality.causes[0].name in right if name != "none" else quality.held_back_db >= POOR
    figures = f"{quality.held_back_db:.2f} | {quality.projection_db:.2f} | {true_db(run, truth):.2f}"
    return f"| {name} | {figures} | {causes} | {good} |", good


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="for the runs")
    parser.add_argument("names", nargs="*", metavar="FAULT", help="default: all")
    arguments = parser.parse_args(list(argv))
    set_variant("llvm")
    from benchmarks.faulty_rooms import faults, room_capture

    truth, walls = room_capture()
    cases = faults(truth, walls)
    print("| fault | held back | projection | true | causes | right |\n|---|---|---|---|---|---|", flush=True)
    results = []
    for name in arguments.names or cases:
        case, right = cases[name]
        line, good = row(name, case, right, arguments.folder / name.replace(" ", "-"), truth)
        print(line, flush=True)
        results.append(good)
    print(f"{sum(results)} of {len(results)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
