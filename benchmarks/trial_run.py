"""One estimation of benchmarks/trial.py in a process of its own: `trial_run.py RUN [CAPTURE] [options]`.

Estimates a prepared run folder, if wanted with other constants, and scores it. Nothing is baked to textures.
Constants are set before the engine's modules are imported; therefore the imports are inside functions.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import constants

# What a finished run leaves for runs that differ from it later on: the stages that make the room, and those
# up to the shadings.
COMPLETED, BAKED = "completed", "baked"
TRAINING_VIEWS = 4  # of which maps are scored, beside those held back
SPP = 16  # paths a pixel of the renders


def estimate(root: Path, store: Path | None) -> dict[str, Any]:
    """Do the estimation of a run folder.

    Args:
        store: folder that gets what later runs may begin with; None: nothing is kept.

    Returns:
        `seconds` of the processor by step, and the number of `fixtures`.
    """
    from fipt_blender.core.device.variant import set_variant
    from fipt_blender.core.run.messages import Reporter
    from fipt_blender.core.run.runfolder import RunFolder

    run = RunFolder(root)
    settings = run.read()
    set_variant(settings.device)
    from fipt_blender.core.estimate.estimation import estimate_room
    from fipt_blender.core.estimate.input import prepare_input
    from fipt_blender.core.optics.brdf import set_masking
    from fipt_blender.core.run.chain import Watch

    seconds: dict[str, float] = {}

    class Timed(Watch):
        """Notes the time of each stage, and copies the stages before they are replaced."""

        def before(self, name: str) -> None:
            self.started = time.process_time()

        def after(self, name: str, new: bool) -> None:
            if new:
                seconds[name] = time.process_time() - self.started
            if name == "shadings" and store is not None:
                shutil.copytree(run.stage, store / BAKED, dirs_exist_ok=True)

    set_masking(settings.masking)
    started, known = time.process_time(), run.scan.exists()
    with run.log.open("a", encoding="utf-8") as log:
        reporter = Reporter(log)
        given = prepare_input(run, settings, reporter)
        if not known:
            seconds["completion"] = time.process_time() - started
        if store is not None:
            shutil.copytree(run.scan, store / COMPLETED, dirs_exist_ok=True)
        statistics = estimate_room(given, reporter, watch=Timed())
    return {"seconds": seconds, "fixtures": statistics["fixtures"]}


def score(root: Path, capture: Path) -> dict[str, Any]:
    """The `figures` of benchmarks/accuracy.py of a finished run, without Cycles, and counts of `lamps`."""
    from benchmarks import accuracy, lamps, picture_page
    from fipt_blender.core.run.runfolder import RunFolder

    page = picture_page.PicturePage(root / "accuracy")
    scope = accuracy.Scope(capture, spp=SPP, train_views=TRAINING_VIEWS, train_renders=0)
    run = RunFolder(root)
    figures = accuracy.score(run, scope, page).figures
    known = (capture / "emitters.json").is_file()
    return {"figures": figures, "lamps": asdict(lamps.lamps_of_run(run, capture)) if known else None}


def main(argv: list[str]) -> int:
    """Run the command; what it finds out is written to RUN/trial.json."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("capture", type=Path, nargs="?", metavar="CAPTURE", help="with ground truth")
    parser.add_argument("--store", type=Path, metavar="DIR", help="keep stages there for other runs")
    parser.add_argument("--constants", default="{}", metavar="JSON", help='{"module.NAME": value}')
    arguments = parser.parse_args(argv)
    # As the engine's own command: torch's threads otherwise spin while they wait for busy cores.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    constants.use(json.loads(arguments.constants))
    found = estimate(arguments.run, arguments.store)
    if arguments.capture is not None:
        found |= score(arguments.run, arguments.capture)
    from fipt_blender.core.run.method import method_digest
    from fipt_blender.core.run.runfolder import write_json

    write_json(arguments.run.absolute() / "trial.json", {**found, "method": method_digest()})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
